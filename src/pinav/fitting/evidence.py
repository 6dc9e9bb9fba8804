r"""The evidence of a linear model with a Gaussian prior, and its best hyperparameters.

Residuals are normal with standard deviation $\sigma$. The weights $w$ have the prior
$N(0, a^2 K_\ell)$; all other unknowns have a flat one and are integrated out, so that
$\sigma$ is not estimated too small (restricted likelihood). With $C C^\top = K_\ell$,
$\beta = \sigma^2/a^2$ and the eigenvalues $e_i$ of $C^\top H C$,

$$-2 \log Z = n \log 2\pi\sigma^2 + m(\beta)/\sigma^2
  + \sum_i \log(1 + e_i/\beta) + \log\det,$$

where $m$ is the least regularised sum of squares, $n$ the number of residuals less the
number of flat unknowns and det the determinant of what was integrated out.

References:
    MacKay, Neural Computation 4, 415 (1992); Rasmussen and Williams, Gaussian
    Processes for Machine Learning (2006), chapter 5; Patterson and Thompson,
    Biometrika 58, 545 (1971).
"""

from collections.abc import Callable, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from pinav.errors import FitError

RATIOS = np.geomspace(1e2, 1e-14, 149)
r"""Values of $\beta$ that are tried, relative to the largest eigenvalue."""


class Quadratic(eqx.Module):
    r"""Sum of squares about a point, and what it hides.

    $q + 2\,g\cdot\delta + \delta\cdot H\,\delta$ with $\delta = \theta - \theta_0$.
    About the origin it would be a small difference of large numbers.

    Attributes:
        point: $\theta_0$.
        hessian: $H$.
        gradient: $g$.
        squares: $q$.
        num_free: residuals less flat unknowns integrated out so far.
        log_determinant: of the blocks integrated out so far.
    """

    point: Float[np.ndarray, " parameter"]
    hessian: Float[np.ndarray, "parameter parameter"]
    gradient: Float[np.ndarray, " parameter"]
    squares: float
    num_free: int
    log_determinant: float


class FlatBlock(eqx.Module):
    """Parameters with a flat prior, given the weights.

    Attributes:
        mask: which of all parameters they are.
        offset: their values where the weights are zero.
        slope: their change per weight.
        covariance: their covariance given the weights, for unit noise.
    """

    mask: Bool[np.ndarray, " parameter"]
    offset: Float[np.ndarray, " flat"]
    slope: Float[np.ndarray, "flat weight"]
    covariance: Float[np.ndarray, "flat flat"]


def without_flat(
    quadratic: Quadratic, mask: Bool[np.ndarray, " parameter"]
) -> tuple[Quadratic, FlatBlock]:
    """Integrate out the parameters in `mask`, which have a flat prior.

    Raises:
        FitError: the data do not determine them, even with the weights known.
    """
    hessian, gradient = quadratic.hessian, quadratic.gradient
    own, border = hessian[np.ix_(mask, mask)], hessian[np.ix_(mask, ~mask)]
    if is_singular(own):
        raise FitError(
            "the fit is singular: the data do not determine the learned constants; "
            "learn fewer of them"
        )
    covariance = np.linalg.inv(own)
    slope, change = -covariance @ border, -covariance @ gradient[mask]
    point = quadratic.point
    block = FlatBlock(
        mask=mask,
        offset=point[mask] + change - slope @ point[~mask],
        slope=slope,
        covariance=covariance,
    )
    reduced = Quadratic(
        point=point[~mask],
        hessian=hessian[np.ix_(~mask, ~mask)] + border.T @ slope,
        gradient=gradient[~mask] + border.T @ change,
        squares=quadratic.squares + float(gradient[mask] @ change),
        num_free=quadratic.num_free - int(mask.sum()),
        log_determinant=quadratic.log_determinant
        + float(np.linalg.slogdet(own).logabsdet),
    )
    return reduced, block


def is_singular(matrix: Float[np.ndarray, "n n"]) -> bool:
    """Whether a normal matrix, its rows and columns scaled, lost all digits."""
    scale = np.sqrt(np.diag(matrix))
    if not (np.all(np.isfinite(matrix)) and np.all(scale > 0)):
        return True
    if not scale.size:
        return False
    eigenvalues = np.linalg.eigvalsh(matrix / np.outer(scale, scale))
    return bool(eigenvalues[0] < 1e-13 * eigenvalues[-1])


class Hyperparameters(eqx.Module):
    r"""What the evidence chooses.

    Attributes:
        length_scale: $\ell$ of the prior [L].
        amplitude: $a$ of the prior, in the unit of the weights.
        noise: $\sigma$.
        log_evidence: $\log Z$.
    """

    length_scale: float
    amplitude: float
    noise: float
    log_evidence: float


Covariance = Callable[[float], Float[np.ndarray, "weight weight"]]
"""Prior covariance of the weights for a length scale, of unit amplitude."""


def best_hyperparameters(
    quadratic: Quadratic,
    covariance: Covariance,
    length_scales: Sequence[float] | Float[np.ndarray, " candidate"],
    noise: float | None = None,
) -> Hyperparameters:
    """The hyperparameters of highest evidence, on a grid of candidates.

    Args:
        quadratic: in the weights alone.
        covariance: prior of the weights.
        length_scales: candidates [L].
        noise: standard deviation of the residuals; estimated unless given.
    """
    candidates = [
        _best_amplitude(quadratic, covariance(float(scale)), float(scale), noise)
        for scale in length_scales
    ]
    return max(candidates, key=lambda chosen: chosen.log_evidence)


class _Whitened(eqx.Module):
    """The quadratic in independent weights of unit prior variance.

    Attributes:
        columns: from these weights to the weights.
        point: where the quadratic is expanded.
        eigenvalues: its diagonal Hessian, not negative.
        gradient: its gradient there.
    """

    columns: Float[np.ndarray, "weight weight"]
    point: Float[np.ndarray, " weight"]
    eigenvalues: Float[np.ndarray, " weight"]
    gradient: Float[np.ndarray, " weight"]

    @classmethod
    def of(cls, quadratic: Quadratic, prior: Float[np.ndarray, "weight weight"]):
        factor = np.linalg.cholesky(prior)
        eigenvalues, vectors = np.linalg.eigh(factor.T @ quadratic.hessian @ factor)
        columns = factor @ vectors
        return cls(
            columns=columns,
            point=vectors.T @ np.linalg.solve(factor, quadratic.point),
            eigenvalues=np.maximum(eigenvalues, 0.0),
            gradient=columns.T @ quadratic.gradient,
        )


def _best_amplitude(quadratic, prior, length_scale, noise):
    white = _Whitened.of(quadratic, prior)
    ratios = RATIOS * max(white.eigenvalues[-1], np.finfo(float).tiny)
    shifted = white.eigenvalues[:, None] + ratios
    slopes = white.gradient[:, None] + ratios * white.point[:, None]
    penalty = ratios * (white.point @ white.point)
    squares = quadratic.squares + penalty - (slopes**2 / shifted).sum(axis=0)
    squares = np.maximum(squares, np.finfo(float).eps * abs(quadratic.squares))
    squares = np.maximum(squares, np.finfo(float).tiny)
    variances = squares / quadratic.num_free if noise is None else noise**2
    values = -0.5 * (
        quadratic.num_free * np.log(2 * np.pi * variances)
        + squares / variances
        + np.log(shifted / ratios).sum(axis=0)
        + quadratic.log_determinant
    )
    best = int(np.argmax(values))
    variance = float(np.broadcast_to(variances, values.shape)[best])
    return Hyperparameters(
        length_scale=length_scale,
        amplitude=float(np.sqrt(variance / ratios[best])),
        noise=float(np.sqrt(variance)),
        log_evidence=float(values[best]),
    )


def weight_posterior(
    quadratic: Quadratic,
    prior: Float[np.ndarray, "weight weight"],
    chosen: Hyperparameters,
) -> tuple[Float[np.ndarray, " weight"], Float[np.ndarray, "weight weight"]]:
    r"""Mean and covariance of the weights, $(H/\sigma^2 + K^{-1}/a^2)^{-1}$."""
    white = _Whitened.of(quadratic, prior)
    ratio = (chosen.noise / chosen.amplitude) ** 2
    shifted = white.eigenvalues + ratio
    change = -(white.gradient + ratio * white.point) / shifted
    mean = quadratic.point + white.columns @ change
    return mean, chosen.noise**2 * (white.columns / shifted) @ white.columns.T


def joint_posterior(
    block: FlatBlock,
    mean: Float[np.ndarray, " weight"],
    covariance: Float[np.ndarray, "weight weight"],
    noise: float,
) -> tuple[Float[np.ndarray, " parameter"], Float[np.ndarray, "parameter parameter"]]:
    """Mean and covariance of all parameters from those of the weights."""
    total, mask = len(block.mask), block.mask
    map_weights = np.zeros((total, len(mean)))
    map_weights[~mask] = np.eye(len(mean))
    map_weights[mask] = block.slope
    joint = map_weights @ covariance @ map_weights.T
    joint[np.ix_(mask, mask)] += noise**2 * block.covariance
    offset = np.zeros(total)
    offset[mask] = block.offset
    return offset + map_weights @ mean, joint
