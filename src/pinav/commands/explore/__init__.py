"""Options of `pinav explore`."""

from pathlib import Path

import tyro

from pinav.commands.settings import Settings


class ExploreOptions(Settings, frozen=True):
    """Write explore.html, a page in which the model of a run is tried by hand.

    The page holds the learned force and its posterior as numbers and evaluates them in
    the browser: drag the start and see the path with its 95 % band. It is one file,
    needs no network, and is not allowed to use one.

    Attributes:
        run: Folder of pinav fit, identify, reproduce, navigate or heat.
        fit: Run of the model that a plan was made with, where it does not lie beside
            that of the plan.
    """

    run: tyro.conf.Positional[Path]
    fit: Path | None = None
