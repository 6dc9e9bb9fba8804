"""Settings of `python -m validation.truth`."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.settings import RunOptions, Settings


class TruthSettings(Settings, frozen=True):
    """Settings of `python -m validation.truth`.

    Attributes:
        only: Cases that are judged, by the names of their folders; all of them unless
            given.
        peer: Whether StochasticForceInference runs on the same recordings.
    """

    only: tuple[str, ...] = ()
    peer: Annotated[
        bool,
        tyro.conf.arg(
            help="Leave out StochasticForceInference, which runs on the same "
            "recordings where it is installed."
        ),
    ] = True


class TruthOptions(RunOptions, frozen=True, kw_only=True):
    """Fit recordings whose truth is known independently, and judge the fits by it.

    Densities and currents, equipartition, hydrodynamics near a wall and weights are
    known without any regression on increments. Each folder with a recording is a case:
    the four public ones by their names, any other by a truth.toml in it.

    Attributes:
        folder: Folder of the cases, or of one.
    """

    folder: tyro.conf.Positional[Path]
    settings: TruthSettings = TruthSettings()
