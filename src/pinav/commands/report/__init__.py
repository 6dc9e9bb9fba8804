"""`pinav report`: draw the figures and the page of a run again."""

from pathlib import Path

import tyro

from pinav.commands.command import CommandResult
from pinav.commands.settings import Settings


class ReportOptions(Settings, frozen=True):
    """Draw the figures and the HTML page of a finished run again.

    Attributes:
        run: Folder of a finished run.
    """

    run: tyro.conf.Positional[Path]


def run(options: ReportOptions) -> CommandResult:
    """Write the report of a finished run again."""
    from pinav.runs import RunFolder

    return CommandResult(None, "", RunFolder.open(options.run))
