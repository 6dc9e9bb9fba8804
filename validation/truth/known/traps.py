r"""What is known of a trapped bead without a model of its increments.

Equipartition, $k_B T / k$ = the variance of the position, and the decay of the
autocorrelation. A camera's blur lowers the variance, and scales the autocorrelation at
lags of a frame and more without bending it: with $x = \lambda T$

$$C_0 = \frac{k_B T}{k}\,\frac{2 (x - 1 + e^{-x})}{x^2}, \qquad
C_k = \frac{k_B T}{k}\,\frac{2 (\cosh x - 1)}{x^2}\, e^{-\lambda k \tau}.$$

So lags of one frame and more give the rate and, extrapolated, the variance; the
recorded one then tells the exposure, on which the stiffness depends by 1 % alone.

References:
    Wong and Halvorsen, Opt. Express 14, 12517 (2006).
"""

import itertools
from collections.abc import Callable

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq

from pinav.errors import InputError
from pinav.fitting import Estimate

LAGS = 4
"""Lags of the autocorrelation that are used, from one frame on."""

BLOCKS, LONG_BLOCKS = 40, 10
"""Blocks that are left out in turn; fewer where a slow wander decides the error."""


class TrapTruth(eqx.Module):
    r"""Moments of a trapped bead, with errors from whole blocks.

    Attributes:
        rate: $\lambda$ from the autocorrelation at lags 1 to 4 [T⁻¹].
        variance: $k_B T / k$, the variance without blur [L²].
        recorded_variance: with blur: what the naive estimate takes [L²].
        naive_rate: from the correlation at one lag, without blur [T⁻¹].
        interval: between frames [T].
        correlation: autocovariance at lags 0 to 20 [L²].
        correlation_sd: its standard deviation [L²].
    """

    rate: Estimate
    variance: Estimate
    recorded_variance: float
    naive_rate: float
    interval: float
    correlation: Float[np.ndarray, " lag"]
    correlation_sd: Float[np.ndarray, " lag"]

    def stiffness(self, thermal_energy: float) -> Estimate:
        """Stiffness by equipartition [F L⁻¹]."""
        value = thermal_energy / self.variance.value
        return Estimate(value, value * self.variance.sd / self.variance.value)


def trap_truth(
    times: Float[np.ndarray, " frame"], distances: Float[np.ndarray, " frame"]
) -> TrapTruth:
    """Moments of the distances of a bead from its trap.

    Args:
        times: of the frames [T]; frames may be lost.
        distances: of the bead from the trap [L].

    Raises:
        InputError: there are too few frames, or the bead does not relax.
    """
    interval = float(np.median(np.diff(times)))
    frames = np.round((times - times[0]) / interval).astype(int)
    if frames[-1] < 20 * BLOCKS:
        raise InputError(
            f"trap_truth: expected {20 * BLOCKS} frames or more, got {frames[-1] + 1}"
        )
    grid = np.full(frames[-1] + 1, np.nan)
    grid[frames] = distances - distances.mean()
    products = [grid[: len(grid) - k] * grid[k:] for k in range(CORRELATION_LAGS + 1)]
    edges = np.linspace(0, len(grid), BLOCKS + 1).astype(int)
    sums = np.array([_block_sums(p, edges) for p in products])  # lag, block, (sum, n)
    total = sums.sum(axis=1)

    def moments(parts: np.ndarray) -> np.ndarray:
        covariance = parts[:, 0] / parts[:, 1]
        return np.append(_rate_and_variance(covariance, interval), covariance)

    values = moments(total)
    left_out = np.array([moments(total - sums[:, b]) for b in range(BLOCKS)])
    spread = left_out - left_out.mean(axis=0)
    sd = np.sqrt((BLOCKS - 1) / BLOCKS * (spread**2).sum(axis=0))
    covariance = values[2:]
    return TrapTruth(
        Estimate(float(values[0]), float(sd[0])),
        Estimate(float(values[1]), float(sd[1])),
        float(covariance[0]),
        float(-np.log(covariance[1] / covariance[0]) / interval),
        interval,
        covariance,
        sd[2:],
    )


CORRELATION_LAGS = 20
"""Lags at which the autocovariance is kept for figures."""


def _block_sums(products: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Sum and number of the products that are there, in each block."""
    parts = [products[a:b] for a, b in itertools.pairwise(edges)]
    return np.array([(np.nansum(p), np.isfinite(p).sum()) for p in parts])


def _rate_and_variance(
    covariance: Float[np.ndarray, " lag"], interval: float
) -> tuple[float, float]:
    lags = np.arange(1, LAGS + 1)
    later = covariance[1 : LAGS + 1]
    if not (later > 0).all():
        raise InputError(
            "trap_truth: the autocorrelation is not positive at lags 1 to 4; the bead "
            "relaxes within a frame, or there are too few of them"
        )
    # The error of an autocovariance is about the same at all lags.
    slope, height = np.polyfit(lags, np.log(later), 1, w=later)
    if slope >= 0:
        raise InputError("trap_truth: the autocorrelation does not fall at lags 1 to 4")
    rate, extrapolated = -slope / interval, float(np.exp(height))

    def excess(ratio: float) -> float:
        shape = (ratio - 1 + np.exp(-ratio)) / (np.cosh(ratio) - 1)
        return shape - covariance[0] / extrapolated

    least, largest = 1e-3, max(-slope, 2e-3)
    if excess(least) <= 0:
        ratio = least
    elif excess(largest) >= 0:
        ratio = largest
    else:
        ratio = _root(excess, least, largest)
    return rate, extrapolated * ratio**2 / (2 * (np.cosh(ratio) - 1))


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    return float(np.asarray(brentq(function, low, high)))


def measured_lag(
    times: Float[np.ndarray, " frame"],
    positions: Float[np.ndarray, " frame"],
    drive: Float[np.ndarray, " frame"],
) -> Estimate:
    r"""Time $1/\lambda$ by which a bead lags behind its moving trap [T].

    The mean distance over the speed, where the speed is steady and the drive is taken
    as true; where it changes, the slope of the distance against the speed. It depends
    neither on the scale of length nor on the temperature. Errors are those of ten
    blocks, so that a slow wander of the trap is in them.

    Args:
        times: of the frames [T].
        positions: of the bead [L].
        drive: where the trap was commanded to be [L].

    Raises:
        InputError: the trap does not move.
    """
    edges = np.linspace(0, len(times), LONG_BLOCKS + 1).astype(int)
    rows = []
    for a, b in itertools.pairwise(edges):
        speed = np.polyfit(times[a:b], drive[a:b], 1)[0]
        rows.append((speed, np.mean(drive[a:b] - positions[a:b])))
    speeds, behind = np.array(rows).T
    if not np.abs(speeds).max() > 0:
        raise InputError("measured_lag: expected a trap that moves, got one at rest")
    steady = np.ptp(speeds) < 0.5 * np.abs(speeds).max()

    def lag(keep: np.ndarray) -> float:
        if steady:
            return behind[keep].mean() / speeds[keep].mean()
        return np.polyfit(speeds[keep], behind[keep], 1)[0]

    every = np.arange(LONG_BLOCKS)
    left_out = np.array([lag(every != b) for b in every])
    spread = ((left_out - left_out.mean()) ** 2).sum()
    sd = np.sqrt((LONG_BLOCKS - 1) / LONG_BLOCKS * spread)
    return Estimate(float(lag(every >= 0)), float(sd))
