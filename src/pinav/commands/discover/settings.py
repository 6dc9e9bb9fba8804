"""Options of `pinav discover`."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.settings import AsJson, Settings, check_counts


class DiscoverOptions(Settings, frozen=True):
    """Find the law behind the learned force of a run of pinav fit.

    Fits about a dozen potentials and rotational terms to the learned force, refits
    the best of them to the trajectories, and prints them with 95 % intervals, or
    that the data do not identify one. Writes laws.json and report.html into the run.
    """

    run: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(help="Folder of pinav fit.")
    ]
    refits: Annotated[
        int, tyro.conf.arg(help="Number of laws refitted to the trajectories.")
    ] = 5
    json: AsJson = False

    def check(self) -> None:
        """Raise `InputError` where a setting makes no sense."""
        check_counts(self, "refits")
