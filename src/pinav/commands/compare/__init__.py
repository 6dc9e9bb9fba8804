"""The command `pinav compare`."""

from pinav.commands.command import Command

COMPARE = Command(
    name="compare",
    summary="compare the evidence of several models of the same data",
    options="pinav.commands.compare.settings:CompareOptions",
    run="pinav.commands.compare.job:run",
    title="A comparison of models",
    result="pinav.commands.compare.result:Comparison",
    file="metrics",
    sections="pinav.commands.compare.sections:sections",
    resumable=True,
)
