"""The command `pinav inspect`."""

from pinav.commands.command import Command

INSPECT = Command(
    name="inspect",
    summary="say what a recording holds, before any fit",
    options="pinav.commands.inspect.settings:InspectOptions",
    run="pinav.commands.inspect.job:run",
)
