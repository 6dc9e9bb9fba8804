"""Options of `pinav evaluate`."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.settings import AsJson, ReadingWords, Settings
from pinav.reading import PLAIN


class EvaluateOptions(Settings, frozen=True):
    """Score the models of a run on trajectories that it was not fitted to.

    The scores say where the run can be trusted; those of training data are said to be
    training errors. They are: rollouts over time, also from clean starts beyond the
    training horizon; the force in visited, near and unvisited regions; coverage of the
    bands; whiteness of the residuals; learned constants. Where the data are noisy or
    incomplete, each start is estimated from the first 20 samples and the others are
    scored. Writes evaluation.json and evaluation.csv into the run, and figures into
    its report.

    Attributes:
        run: Folder of a fitted run.
        data: Trajectories, .npz or .csv, or a recording.
        calibrate: Further trajectories, from which bands that hold 95 % of new
            trajectories are calibrated (split-conformal).
        regions: Distances from the data up to which places are visited, and near; 0.35
            and 1 for dimensionless data, else 1/40 and 1/14 of their extent.
    """

    run: tyro.conf.Positional[Path]
    data: tyro.conf.Positional[Path]
    calibrate: Path | None = None
    regions: Annotated[
        tuple[float, float] | None, tyro.conf.arg(metavar="FLOAT FLOAT")
    ] = None
    reading: ReadingWords = PLAIN
    json: AsJson = False
