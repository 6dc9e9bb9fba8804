"""The command `pinav report`."""

from pinav.commands.command import Command

REPORT = Command(
    name="report",
    summary="draw the figures and the HTML page of a run again",
    options="pinav.commands.report.settings:ReportOptions",
    run="pinav.commands.report.job:run",
)
