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
    r"""Sum of squares $q + 2\,g\cdot\theta + \theta\cdot H\,\theta$, and what it hides.

    Attributes:
        hessian: $H$.
        gradient: $g$.
        squares: $q$.
        num_free: residuals less flat unknowns integrated out so far.
        log_determinant: of the blocks integrated out so far.
    """

    hessian: Float[np.ndarray, "parameter parameter"]
    gradient: Float[np.ndarray, " parameter"]
    squares: float
    num_free: int
    log_determinant: float

    @classmethod
    def about(
        cls,
        theta: Float[np.ndarray, " parameter"],
        hessian: Float[np.ndarray, "parameter parameter"],
        gradient: Float[np.ndarray, " parameter"],
        squares: float,
        *,
        num_free: int,
        log_determinant: float,
    ) -> "Quadratic":
        """The quadratic whose coefficients are given for changes of `theta`."""
        origin = squares - 2 * gradient @ theta + theta @ hessian @ theta
        gradient = gradient - hessian @ theta
        return cls(hessian, gradient, float(origin), num_free, log_determinant)


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
    block = FlatBlock(
        mask=mask,
        offset=-covariance @ gradient[mask],
        slope=-covariance @ border,
        covariance=covariance,
    )
    reduced = Quadratic(
        hessian=hessian[np.ix_(~mask, ~mask)] + border.T @ block.slope,
        gradient=gradient[~mask] + border.T @ block.offset,
        squares=quadratic.squares + float(gradient[mask] @ block.offset),
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


def _best_amplitude(quadratic, prior, length_scale, noise):
    factor = np.linalg.cholesky(prior)
    eigenvalues, vectors = np.linalg.eigh(factor.T @ quadratic.hessian @ factor)
    eigenvalues = np.maximum(eigenvalues, 0.0)
    projections = (vectors.T @ (factor.T @ quadratic.gradient)) ** 2
    ratios = RATIOS * max(eigenvalues[-1], np.finfo(float).tiny)
    shifted = eigenvalues[:, None] + ratios
    squares = quadratic.squares - (projections[:, None] / shifted).sum(axis=0)
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
    ratio = (chosen.noise / chosen.amplitude) ** 2
    factor = np.linalg.cholesky(prior)
    whitened = factor.T @ quadratic.hessian @ factor
    eigenvalues, vectors = np.linalg.eigh(whitened)
    columns = factor @ vectors / np.sqrt(np.maximum(eigenvalues, 0.0) + ratio)
    mean = -columns @ (columns.T @ quadratic.gradient)
    return mean, chosen.noise**2 * columns @ columns.T


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
