"""What a judge of one kind of recording hands back."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pinav.commands.truth.metrics import TruthRow


class Curve(NamedTuple):
    """A field beside its truth.

    Attributes:
        title: what is shown.
        labels: of the two axes, with units.
        places: along the field.
        learned: the field.
        sd: its standard deviation.
        truth: at the same places.
        truth_sd: standard deviation of the truth.
    """

    title: str
    labels: tuple[str, str]
    places: Float[np.ndarray, " place"]
    learned: Float[np.ndarray, " place"]
    sd: Float[np.ndarray, " place"]
    truth: Float[np.ndarray, " place"]
    truth_sd: Float[np.ndarray, " place"]


class Judgement(NamedTuple):
    """Rows, figures and remarks of one case.

    Attributes:
        rows: quantities beside their truths.
        curves: fields beside theirs.
        notes: what else the fit says, in sentences.
        seconds: from reading to the last row, StochasticForceInference apart.
    """

    rows: tuple[TruthRow, ...]
    curves: tuple[Curve, ...]
    notes: tuple[str, ...]
    seconds: float
