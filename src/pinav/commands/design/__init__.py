"""The command `pinav design`."""

from pinav.commands.command import Command

DESIGN = Command(
    name="design",
    summary="choose which trajectories to record until a way is known",
    options="pinav.commands.design.settings:DesignOptions",
    run="pinav.commands.design.job:run",
    title="Design of experiments",
    result="pinav.navigation.design.result:DesignResult",
    file="metrics",
    sections="pinav.commands.design.sections:sections",
)
