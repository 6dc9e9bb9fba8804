"""Options of `pinav report`."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.settings import (
    Settings,
)


class ReportOptions(Settings, frozen=True):
    """Draw the figures and the HTML page of a finished run again."""

    run: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(help="Folder of a finished run.")
    ]
