r"""A bank of Kalman filters, one for each hypothesis about the drive.

Along each axis the state is $(p, w, b, g_1, g_2)$: position, wandering velocity, drift
and a row of the gain matrix. From one block to the next

$$p' = p + g \cdot \Delta C + b\,\Delta t + T (1 - e^{-\Delta t/T})\, w + \epsilon$$

with an Ornstein-Uhlenbeck velocity w of memory T. Both axes have the same regressors
and noise, so that one covariance serves both. All variances are in units of an unknown
$\sigma^2$, the wandering at 1 Hz, whose inverse has a gamma posterior: its integral is
the evidence, and no grid of strengths is needed.

References:
    West and Harrison, Bayesian Forecasting and Dynamic Models (1997), section 4.5, for
    the unknown variance.
"""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.identification.kalman import ornstein_uhlenbeck

P, W, B, G = 0, 1, 2, slice(3, 5)
"""Places in the state."""

STILL = 0.3
"""Wandering speed at rest, in parts of that at 1 Hz."""

DRIFT_PRIOR, GAIN_PRIOR = 3.0, 100.0
"""Standard deviations of the priors of drift and gain, in wandering speeds at 1 Hz."""

SIGMA_PRIOR = 0.1
"""Wandering speed at 1 Hz that is expected, in parts of the speed there."""


class Bank(eqx.Module):
    r"""States of all members.

    Attributes:
        mean: mean state of each member along each axis.
        covariance: that of each member, the same along both axes, over $\sigma^2$.
        log_weight: logarithm of the evidence of each member, less that of the best.
        squares: rate of the gamma posterior of $1/\sigma^2$ of each member.
        count: shape of that posterior, the same for all.
    """

    mean: Float[np.ndarray, "member 2 5"]
    covariance: Float[np.ndarray, "member 5 5"]
    log_weight: Float[np.ndarray, " member"]
    squares: Float[np.ndarray, " member"]
    count: float

    @classmethod
    def prior(cls, log_prior: Float[np.ndarray, " member"], scale: float) -> "Bank":
        """The bank before any block.

        Args:
            log_prior: of the members.
            scale: rough speed per frequency [L per cycle].
        """
        members = len(log_prior)
        covariance = np.zeros((members, 5, 5))
        covariance[:, B, B] = DRIFT_PRIOR**2
        covariance[:, 3, 3] = covariance[:, 4, 4] = GAIN_PRIOR**2
        squares = np.full(members, (SIGMA_PRIOR * scale) ** 2)
        return cls(np.zeros((members, 2, 5)), covariance, log_prior, squares, 1.0)

    @property
    def weight(self) -> Float[np.ndarray, " member"]:
        """Posterior probability of each member."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        return weight / weight.sum()

    @property
    def variance_unit(self) -> Float[np.ndarray, " member"]:
        r"""Mean of $\sigma^2$ of each member [L² T⁻²]."""
        return self.squares / max(self.count - 1.0, 1.0)

    def place(
        self, position: Float[np.ndarray, "2"], blur: Float[np.ndarray, " member"]
    ) -> "Bank":
        """At a position that says nothing of the past; the wandering begins anew."""
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[:, :, P], mean[:, :, W] = position, 0.0
        for place, variance in ((P, blur**2), (W, 1.0)):
            covariance[:, place, :] = covariance[:, :, place] = 0.0
            covariance[:, place, place] = variance
        return eqx.tree_at(lambda b: (b.mean, b.covariance), self, (mean, covariance))

    def predict(
        self,
        cycles: Float[np.ndarray, "member 2"],
        interval: float,
        memory: Float[np.ndarray, " member"],
        frequency: float,
    ) -> "Bank":
        """The states after an interval.

        Args:
            cycles: integral of the delayed response along the heading, of each member.
            interval: from mean time to mean time [s].
            memory: correlation time of each member [s].
            frequency: mean of it [Hz].
        """
        decay = np.exp(-interval / memory)
        row = rows(cycles, interval, memory)
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[:, :, P] = np.einsum("mas,ms->ma", self.mean, row)
        mean[:, :, W] *= decay[:, None]
        across = np.einsum("mst,mt->ms", self.covariance, row)
        covariance[:, P, :] = covariance[:, :, P] = across
        covariance[:, P, P] = np.einsum("ms,ms->m", across, row)
        covariance[:, W, :] *= decay[:, None]
        covariance[:, :, W] *= decay[:, None]
        position, cross, velocity = wandering(interval, memory, frequency)
        covariance[:, P, P] += position
        covariance[:, P, W] += cross
        covariance[:, W, P] += cross
        covariance[:, W, W] += velocity
        return eqx.tree_at(lambda b: (b.mean, b.covariance), self, (mean, covariance))

    def update(
        self, position: Float[np.ndarray, "2"], blur: Float[np.ndarray, " member"]
    ) -> "Bank":
        r"""The states and weights that know a mean position [L].

        Args:
            position: of a block.
            blur: standard deviation of its error, over $\sigma$ [s].
        """
        variance = self.covariance[:, P, P] + blur**2
        column = self.covariance[:, :, P]
        gain = column / variance[:, None]
        innovation = position - self.mean[:, :, P]
        mean = self.mean + innovation[:, :, None] * gain[:, None]
        # Column times column, not gain times column: symmetric to the last bit.
        known = column[:, :, None] * column[:, None] / variance[:, None, None]
        squares = self.squares + 0.5 * (innovation**2).sum(axis=1) / variance
        log_weight = self.log_weight - np.log(variance)
        log_weight += self.count * np.log(self.squares)
        log_weight -= (self.count + 1) * np.log(squares)
        return Bank(
            mean,
            self.covariance - known,
            log_weight - log_weight.max(),
            squares,
            self.count + 1.0,
        )


def rows(
    cycles: Float[np.ndarray, "*batch member 2"],
    interval: float | Float[np.ndarray, "*#batch 1"],
    memory: Float[np.ndarray, " member"],
) -> Float[np.ndarray, "*batch member 5"]:
    """Displacement by each part of the state after an interval [s]."""
    row = np.empty((*cycles.shape[:-1], 5))
    row[..., P], row[..., B] = 1.0, interval
    row[..., W] = memory * -np.expm1(-interval / memory)
    row[..., G] = cycles
    return row


def wandering(
    interval: float,
    memory: Float[np.ndarray, " member"],
    frequency: float | Float[np.ndarray, "*plan 1"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r"""Variances that wandering adds in an interval, over $\sigma^2$.

    Of the position, of position with velocity, and of the velocity, for the strength
    at a frequency [Hz].
    """
    strength = STILL**2 + np.sqrt(np.maximum(frequency, 0.0))
    lost, _, spread, fresh = ornstein_uhlenbeck(interval / memory, np)
    return (
        strength * memory**2 * spread,
        strength * memory * lost**2,
        strength * fresh,
    )
