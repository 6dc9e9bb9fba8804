"""The command `pinav export`."""

from pinav.commands.command import Command

EXPORT = Command(
    name="export",
    summary="write what a run has learned in the formats of other programs",
    options="pinav.commands.export.settings:ExportOptions",
    run="pinav.commands.export.job:run",
)
