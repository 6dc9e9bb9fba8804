"""Options of `pinav report`."""

from pathlib import Path

import tyro

from pinav.commands.settings import (
    Settings,
)


class ReportOptions(Settings, frozen=True):
    """Draw the figures and the HTML page of a finished run again.

    Attributes:
        run: Folder of a finished run.
    """

    run: tyro.conf.Positional[Path]
