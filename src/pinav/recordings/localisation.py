r"""Localisation error and diffusion of a moving particle, from its positions alone.

Third divided differences remove any motion that is a parabola over four samples, with
irregular times too. What they leave of independent errors of variance $\sigma^2$, of a
diffusion $D$ and of a velocity that is itself a random walk, as where commands change
from row to row, has known covariances at lags 0 to 3, linear in all three: errors alone
correlate over three lags, the others over two. Weighted least squares on the measured
covariances gives the numbers; it extends the covariance estimator to particles that
are driven. Robots also jitter, which looks like diffusion from row to row, so that the
scatter of all causes is given beside them.

References:
    Vestergaard, Blainey and Flyvbjerg, Phys. Rev. E 89, 022726 (2014).
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import final

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls

_SAMPLES, _LAGS = 4, 4
_MEDIAN = 0.6744897501960817  # of the size of a standard normal number
_REFINEMENTS = 4
_OUTLIER = 4.0
"""Differences beyond this many deviations are steps of the command, not errors.

They are left out with all differences that share a sample with them.
"""

LEAST_SAMPLES = 20
"""Fewer samples say too little."""


@final
@dataclasses.dataclass(frozen=True)
class Localisation:
    r"""Sources of scatter in the positions of a particle.

    Attributes:
        scatter: standard deviation of a coordinate from all causes, an upper bound of
            the error [L].
        deviation: $\sigma$ of a coordinate, averaged over both [L].
        diffusion: $D$ [L² T⁻¹].
        error: standard error of `deviation`, from tenths of the samples [L].
    """

    scatter: float
    deviation: float
    diffusion: float
    error: float


def localisation(
    times: Sequence[Float[np.ndarray, " _"]],
    positions: Sequence[Float[np.ndarray, "_ 2"]],
) -> Localisation | None:
    """Error and diffusion of one particle over its segments; None with too few samples.

    Args:
        times: of each segment, increasing [T].
        positions: of each segment, NaN where the particle was lost [L].
    """
    parts = [
        _products(moments[observed], path[observed])
        for moments, path in zip(times, positions, strict=True)
        if (observed := np.isfinite(path).all(axis=1)).sum() > _SAMPLES + _LAGS
    ]
    if not parts or sum(len(part) for part in parts) < LEAST_SAMPLES:
        return None
    table = np.concatenate(parts)
    variance, diffusion = _error_and_diffusion(table)
    tenths = [_error_and_diffusion(part)[0] for part in np.array_split(table, 10)]
    spread = np.std(np.sqrt(tenths), ddof=1) / np.sqrt(len(tenths))
    return Localisation(
        scatter=float(np.sqrt(table[:, 0].mean())),
        deviation=float(np.sqrt(variance)),
        diffusion=diffusion,
        error=float(spread),
    )


def _products(
    times: Float[np.ndarray, " time"], path: Float[np.ndarray, "time 2"]
) -> Float[np.ndarray, "window 16"]:
    """Products of the differences at lags 0 to 3, and the factors of each cause.

    The columns are the measured product averaged over both coordinates, then the
    factors of the variance, of the diffusion, and of a velocity that is a random walk.
    """
    count = len(times) - _SAMPLES + 1
    index = np.arange(count)[:, None] + np.arange(_SAMPLES)
    weights = _weights(times[index])
    differences = np.einsum("ij,ijk->ik", weights, path[index])
    scale = np.median(np.abs(differences), axis=0) / _MEDIAN
    odd = (np.abs(differences) > _OUTLIER * scale).any(axis=1)
    usual = np.convolve(odd, np.ones(2 * _SAMPLES - 1), "same") < 0.5
    rows = np.arange(count - _LAGS + 1)
    columns = []
    for lag in range(_LAGS):
        late = rows + lag
        product = (differences[rows] * differences[late]).mean(axis=1)
        columns.append(np.where(usual[rows] & usual[late], product, np.nan))
    for lag in range(_LAGS):
        late = rows + lag
        overlap = weights[rows, lag:] * weights[late, : _SAMPLES - lag]
        columns.append(overlap.sum(axis=1))
    for walk in (_brownian, _integrated_brownian):
        columns += [_of_walk(walk, times, weights, rows, lag) for lag in range(_LAGS)]
    table = np.stack(columns, axis=1)
    return table[np.isfinite(table).all(axis=1)]


def _weights(times: Float[np.ndarray, "window 4"]) -> Float[np.ndarray, "window 4"]:
    """Weights of the third divided difference, with the sum of squares 1."""
    spans = times[:, :, None] - times[:, None, :]
    spans[:, np.arange(_SAMPLES), np.arange(_SAMPLES)] = 1.0
    weights = 1.0 / spans.prod(axis=2)
    return weights / np.linalg.norm(weights, axis=1, keepdims=True)


def _of_walk(
    covariance: Callable[[np.ndarray, np.ndarray], np.ndarray],
    times: np.ndarray,
    weights: np.ndarray,
    rows: np.ndarray,
    lag: int,
) -> Float[np.ndarray, " window"]:
    """Covariance of two differences of a path that starts at rest with the window."""
    offsets = np.arange(_SAMPLES)
    early = times[rows[:, None] + offsets] - times[rows, None]
    late = times[rows[:, None] + lag + offsets] - times[rows, None]
    shared = covariance(early[:, :, None], late[:, None, :])
    return np.einsum("ij,ik,ijk->i", weights[rows], weights[rows + lag], shared)


def _brownian(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Covariance of a Brownian path of diffusion 1 at two times."""
    return 2.0 * np.minimum(one, other)


def _integrated_brownian(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Covariance of an integrated random walk of unit intensity at two times."""
    first, last = np.minimum(one, other), np.maximum(one, other)
    return first**2 * (3 * last - first) / 6


def _error_and_diffusion(table: Float[np.ndarray, "window 16"]) -> tuple[float, float]:
    """Variance of the error and diffusion, neither of them negative."""
    measured, *causes = np.split(table.mean(axis=0), 4)
    design = np.stack([cause / cause[0] for cause in causes], axis=1)
    root = np.eye(_LAGS)
    variances = np.zeros(len(causes))
    for _ in range(_REFINEMENTS):
        variances, _ = nnls(root @ design, root @ measured)
        root = np.linalg.inv(np.linalg.cholesky(_sampling(design @ variances)))
    variance = min(variances[0], max(measured[0], 0.0))  # of all causes
    return float(variance), float(variances[1] / causes[1][0])


def _sampling(covariances: np.ndarray) -> np.ndarray:
    """Covariance of the measured covariances of normal numbers, up to a factor.

    References:
        Bartlett, J. R. Stat. Soc. Suppl. 8, 27 (1946).
    """
    lags = np.arange(-2 * _LAGS, 2 * _LAGS + 1)

    def at(lag: np.ndarray) -> np.ndarray:
        inside = np.abs(lag) < _LAGS
        return np.where(inside, covariances[np.minimum(np.abs(lag), _LAGS - 1)], 0.0)

    one, other = np.arange(_LAGS)[:, None, None], np.arange(_LAGS)[None, :, None]
    k = lags[None, None, :]
    matrix = (at(k) * at(k + one - other) + at(k + one) * at(k - other)).sum(axis=2)
    floor = 1e-9 * np.trace(matrix) + np.finfo(float).tiny
    return matrix + floor * np.eye(_LAGS)
