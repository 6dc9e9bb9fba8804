"""The command `pinav identify`."""

from pinav.commands.command import Command

IDENTIFY = Command(
    name="identify",
    summary="find which response to commands a recording supports",
    options="pinav.commands.identify.settings:IdentifyOptions",
    run="pinav.commands.identify.job:run",
    title="The response of a recorded swimmer",
    result="pinav.identification:Identification",
    file="metrics",
    sections="pinav.commands.identify.sections:sections",
    resumable=True,
)
