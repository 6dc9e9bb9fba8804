"""`pinav report`: draw the figures and the page of a run again."""

from pinav.commands.command import CommandResult
from pinav.commands.report import ReportOptions
from pinav.runs import RunFolder


def run(options: ReportOptions) -> CommandResult:
    """Write the report of a finished run again."""
    return CommandResult(None, "", RunFolder.open(options.run))
