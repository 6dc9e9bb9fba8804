"""Options of `pinav discover`."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.settings import AsJson, Range, Settings


class DiscoverOptions(Settings, frozen=True):
    """Find the law behind the learned force of a run of pinav fit.

    Where the fit found a structure, each of its terms (central, wall, lattice and so
    on) is asked for the formula of its profile; else laws and sums of up to three are
    tried on the whole force. The best are refitted to the trajectories and printed
    with 95 % intervals, or that no law fits, or that the data do not identify one.
    Writes laws.json and report.html into the run.

    Attributes:
        run: Folder of pinav fit.
        refits: Number of laws refitted to the trajectories.
    """

    run: tyro.conf.Positional[Path]
    refits: Annotated[int, Range(1)] = 5
    json: AsJson = False
