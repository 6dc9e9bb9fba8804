"""Options of `pinav discover`."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.settings import AsJson, Range, Settings


class DiscoverOptions(Settings, frozen=True):
    """Find the law behind the learned force of a run of pinav fit.

    Fits about a dozen potentials and rotational terms to the learned force, refits
    the best of them to the trajectories, and prints them with 95 % intervals, or
    that the data do not identify one. Writes laws.json and report.html into the run.

    Attributes:
        run: Folder of pinav fit.
        refits: Number of laws refitted to the trajectories.
    """

    run: tyro.conf.Positional[Path]
    refits: Annotated[int, Range(1)] = 5
    json: AsJson = False
