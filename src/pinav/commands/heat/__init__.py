"""The command `pinav heat`."""

from pinav.commands.command import Command

HEAT = Command(
    name="heat",
    summary="bioheat: simulate a case, learn perfusion, optimise a protocol",
    options="pinav.commands.heat.settings:HeatOptions",
    run="pinav.commands.heat.job:run",
    title="Bioheat",
    result="pinav.thermal.heated_run:AbstractHeatResult",
    file="metrics",
    sections="pinav.commands.heat.sections:sections",
    compiler_flags=False,  # small to compile, and its gradient runs slower with them
)
