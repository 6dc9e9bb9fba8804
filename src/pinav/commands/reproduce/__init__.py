"""The command `pinav reproduce`."""

from pinav.commands.command import Command

REPRODUCE = Command(
    name="reproduce",
    summary="run the paper's experiment: simulate, train, Table 2, report",
    options="pinav.commands.reproduce.settings:ReproduceOptions",
    run="pinav.commands.reproduce.job:run",
    title="The paper's benchmark",
    result="pinav.commands.reproduce.result:Reproduction",
    file="metrics",
    sections="pinav.commands.reproduce.sections:sections",
    resumable=True,
)
