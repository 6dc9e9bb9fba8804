"""Observation by a camera: average over the exposure, error, and links to drift."""

import equinox as eqx
import numpy as np

from pinav.dynamics import OverdampedSwimmer
from pinav.errors import InputError
from pinav.fitting.engine.posterior import Estimate
from pinav.forces import KernelTensor


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


class Relation(eqx.Module):
    """How drift and diffusion hang together, and what of them is known.

    Attributes:
        thermal_energy: $k_BT$ of Einstein's relation; None for a free drift.
        learn_diffusion: whether D is not known.
        observation: priors of exposure and error, where they are learned.
    """

    thermal_energy: float | None
    learn_diffusion: bool
    observation: LearnedObservation | None

    @property
    def einstein(self) -> bool:
        r"""Whether the drift is $\beta D F + \nabla\cdot D$."""
        return self.thermal_energy is not None

    def swimmer_in(
        self, swimmer: OverdampedSwimmer, diffusion: KernelTensor
    ) -> OverdampedSwimmer:
        """The swimmer with the mobility that belongs to the diffusion."""
        if self.thermal_energy is None:
            return swimmer
        mobility = diffusion.scale_by(1 / self.thermal_energy)
        return eqx.tree_at(
            lambda m: m.mobility,
            swimmer,
            mobility,
            is_leaf=lambda leaf: leaf is swimmer.mobility,
        )
