"""What a camera does to a path: it averages over the exposure, and errs."""

import equinox as eqx
import numpy as np

from pinav.errors import InputError
from pinav.fitting.engine.posterior import Estimate


class Observation(eqx.Module):
    """A known observation: the mean over an exposure, with an error.

    Attributes:
        exposure: time [T] before each sample over which the position is averaged.
        error: standard deviation of the error of each coordinate [L].

    Raises:
        InputError: a number is negative or not finite.
    """

    exposure: float = 0.0
    error: float = 0.0

    def __check_init__(self) -> None:
        for name in ("exposure", "error"):
            value = getattr(self, name)
            if not (isinstance(value, float | int) and 0 <= value < np.inf):
                raise InputError(
                    f"Observation.{name}: expected a finite number >= 0, got {value!r}"
                )


class LearnedObservation(eqx.Module):
    r"""An observation whose exposure and error are learned, with weak priors.

    The exposure is a share of the median interval whose log odds are normal about zero;
    the variance of the error, relative to $D\tau$ of that interval, is log-normal about
    `error`. Where D is the same everywhere and the intervals are equal, the two trade
    off, and only their effect $\tfrac13 D T - \sigma^2$ on neighbours is known; D is
    not touched by that.

    Attributes:
        spread: standard deviation of the log odds of the exposure.
        error: median of $\sigma^2 / D\tau$.
        error_spread: standard deviation of its logarithm.

    Raises:
        InputError: a number is not positive.
    """

    spread: float = 1.5
    error: float = 0.05
    error_spread: float = 2.0

    def __check_init__(self) -> None:
        for name in ("spread", "error", "error_spread"):
            if not getattr(self, name) > 0:
                raise InputError(
                    f"LearnedObservation.{name}: expected > 0, got "
                    f"{getattr(self, name)}"
                )


class ObservedAxes(eqx.Module):
    """What a fit says of the observation of some axes.

    Attributes:
        axes: which coordinates.
        exposure: T [T].
        error: standard deviation of the error [L].
        interval: the median interval [T], beyond which no exposure lasts.
    """

    axes: tuple[int, ...] = eqx.field(static=True)
    exposure: Estimate
    error: Estimate
    interval: float
