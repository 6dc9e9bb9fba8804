"""The command `pinav live`."""

from pinav.commands.command import Command

LIVE = Command(
    name="live",
    summary="estimate and steer at a rig that is running",
    options="pinav.commands.live.settings:LiveOptions",
    run="pinav.commands.live.job:run",
    resumable=True,
)
