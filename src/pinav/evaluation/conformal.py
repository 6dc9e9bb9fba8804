r"""Split-conformal bands of rollouts: whole trajectories are the exchangeable unit.

The samples of one trajectory share a start and a path, so their errors are as good as
one observation. Each held-out trajectory $i$ therefore gives one score, its largest
normalised error,

$$s_i = \max_{k, c} |y_{ikc} - \hat y_{ikc}| / \sigma_{ikc},$$

and the radius $r$ is the $\lceil (n+1)(1-\alpha) \rceil$-th smallest of n scores. A new
trajectory, exchangeable with those, stays inside $\hat y \pm r\sigma$ at all its
observed samples with a probability of at least $1-\alpha$, whatever model and
$\sigma$ are; they only decide how wide the band is.

References:
    Lei, G'Sell, Rinaldo, Tibshirani and Wasserman, Distribution-Free Predictive
    Inference for Regression, arXiv:1604.04173, split conformal inference;
    Diquigiovanni, Fontana and Vantini, Statistica Sinica 35, 853 (2025), bands of whole
    functions.
"""

import enum
import math

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from pinav.errors import InputError
from pinav.trajectories import Trajectories

Samples = Float[np.ndarray, "trajectory time state"]


class CalibrationOutcome(enum.Enum):
    """The outcome of a calibration."""

    BOUNDED = "bounded"
    TOO_FEW = "too few trajectories"
    DIVERGED = "diverged"


class Calibration(eqx.Module):
    r"""A band that holds a whole new trajectory with a probability of $1-\alpha$.

    The probability is over the calibration trajectories too, not given them. Where it
    cannot be promised the radius is infinite and `outcome` says why.

    Attributes:
        radius: $r$, in standard deviations $\sigma$.
        miscoverage: $\alpha$.
        outcome: bounded; too few trajectories for this miscoverage; or diverged, so
            many predictions were infinitely wrong that no finite band is honest.
    """

    radius: float
    miscoverage: float
    count: int
    outcome: CalibrationOutcome = eqx.field(static=True)

    def __str__(self) -> str:
        """One line: the radius, or why there is none."""
        level = f"{100 * (1 - self.miscoverage):g} % of new trajectories"
        if self.outcome is CalibrationOutcome.TOO_FEW:
            return (
                f"no finite band holds {level}: {self.count} calibration trajectories "
                f"are too few, {least_count(self.miscoverage)} are needed"
            )
        if self.outcome is CalibrationOutcome.DIVERGED:
            return (
                f"no finite band holds {level}: too many predictions of the "
                f"{self.count} calibration trajectories diverged"
            )
        return (
            f"{self.radius:.3g} standard deviations hold {level}, from {self.count} "
            "calibration trajectories"
        )

    def covers(
        self,
        trajectories: Trajectories,
        predictions: Samples,
        sd: Samples,
        *,
        horizon: float = math.inf,
    ) -> Bool[np.ndarray, " trajectory"]:
        """Trajectories that lie inside the band at all their observed samples.

        A prediction that diverged promises nothing: it covers only where the radius is
        infinite.
        """
        scores = trajectory_scores(trajectories, predictions, sd, horizon=horizon)
        return scores <= self.radius


def calibrate(
    scores: Float[np.ndarray, " trajectory"], miscoverage: float = 0.05
) -> Calibration:
    r"""The radius that the scores of held-out trajectories justify.

    The trajectories must have been used neither to fit nor to choose anything.

    Args:
        scores: one for each trajectory, from `trajectory_scores`; infinite where the
            prediction diverged.
        miscoverage: $\alpha$, the probability of leaving the band.

    Raises:
        InputError: `miscoverage` is not between 0 and 1, there is no score, or a score
            is NaN or negative.
    """
    _check_miscoverage(miscoverage)
    if not len(scores) or not np.all(scores >= 0):
        raise InputError(
            "calibrate scores: expected one number >= 0 for each trajectory, got "
            f"{scores.tolist()[:5]}; a diverged prediction scores infinity"
        )
    count = len(scores)
    rank = count + 1 - math.floor((count + 1) * miscoverage + ROUNDING)
    if rank > count:
        return Calibration(math.inf, miscoverage, count, CalibrationOutcome.TOO_FEW)
    radius = float(np.sort(scores)[rank - 1])
    bounded = math.isfinite(radius)
    outcome = CalibrationOutcome.BOUNDED if bounded else CalibrationOutcome.DIVERGED
    return Calibration(radius, miscoverage, count, outcome)


ROUNDING = 1e-9
r"""By which $(n+1)\alpha$, a whole number but for rounding, may fall short of it."""


def least_count(miscoverage: float) -> int:
    r"""Calibration trajectories below which every band is infinite.

    The smallest n with $(n+1)\,\alpha \ge 1$.

    Raises:
        InputError: `miscoverage` is not between 0 and 1.
    """
    _check_miscoverage(miscoverage)
    return max(math.ceil(1 / miscoverage - ROUNDING) - 1, 1)


def trajectory_scores(
    trajectories: Trajectories,
    predictions: Samples,
    sd: Samples,
    *,
    horizon: float = math.inf,
) -> Float[np.ndarray, " trajectory"]:
    """Largest normalised error of each trajectory, infinite where it diverged.

    Entries that were not observed and padding do not count, so a band calibrated on
    trajectories with holes promises as much of new ones with such holes. A short
    trajectory has fewer chances to leave the band: calibrate on lengths like those
    predicted, or up to a common horizon.

    Args:
        sd: standard deviations of the errors expected; 1 gives a radius in the unit
            of the states.
        horizon: time [T] from the first sample of each after which nothing counts.

    Raises:
        InputError: shapes do not fit, an `sd` is not positive though its prediction
            is finite, or a trajectory has no observed sample within the horizon.
    """
    expected = trajectories.states.shape
    for name, array in (("predictions", predictions), ("sd", sd)):
        if array.shape != expected:
            raise InputError(
                f"trajectory_scores {name}: expected shape {expected}, as the states "
                f"have, got {array.shape}"
            )
    elapsed = trajectories.times - trajectories.times[:, :1]
    counted = trajectories.observed & (elapsed <= horizon)[..., None]
    for index, entries in enumerate(counted):
        if not entries.any():
            raise InputError(
                f"trajectory {index}: no observed sample within the horizon {horizon:g}"
                "; drop the trajectory"
            )
    finite = np.isfinite(predictions) & np.isfinite(sd)
    if np.any(counted & finite & (sd <= 0)):
        raise InputError(
            "trajectory_scores sd: expected > 0 at every observed sample; add the "
            "noise of the observations to the band"
        )
    usable = counted & finite
    errors = np.where(usable, predictions - trajectories.states, 0.0)
    normalised = np.abs(errors) / np.where(usable, sd, 1.0)
    normalised[counted & ~finite] = np.inf
    return normalised.max(axis=(1, 2))


def _check_miscoverage(miscoverage: float) -> None:
    if not 0 < miscoverage < 1:
        raise InputError(
            f"miscoverage: expected a number between 0 and 1, got {miscoverage}"
        )
