"""The command `pinav simulate`."""

from pinav.commands.command import Command

SIMULATE = Command(
    name="simulate",
    summary="write the trajectories of a system to a file",
    options="pinav.commands.simulate.settings:SimulateOptions",
    run="pinav.commands.simulate.job:run",
)
