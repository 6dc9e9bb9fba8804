"""A least-squares problem as a quadratic, and its unknowns with a flat prior."""

import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from pinav.errors import FitError
from pinav.forces.priors import Matrix

Parameters = Float[np.ndarray, " parameter"]
"""Values of all parameters, or a change of them."""


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

    def map_weights(self) -> Float[np.ndarray, "parameter weight"]:
        """From changes of the weights to those of all parameters."""
        full = np.zeros((len(self.mask), self.slope.shape[1]))
        full[~self.mask] = np.eye(self.slope.shape[1])
        full[self.mask] = self.slope
        return full

    def lift(self, covariance: Matrix) -> Float[np.ndarray, "parameter parameter"]:
        """Covariance of all parameters that a covariance of the weights makes."""
        full = self.map_weights()
        return full @ covariance @ full.T


def eliminate_flat(
    quadratic: Quadratic, mask: Bool[np.ndarray, " parameter"]
) -> tuple[Quadratic, FlatBlock]:
    """Integrate out the parameters in `mask`, which have a flat prior."""
    hessian, gradient = quadratic.hessian, quadratic.gradient
    free_block, border = hessian[np.ix_(mask, mask)], hessian[np.ix_(mask, ~mask)]
    if is_singular(free_block):
        raise FitError(
            "the fit is singular: the data do not determine the learned constants; "
            "learn fewer of them"
        )
    covariance = np.linalg.inv(free_block)
    # Schur's complement: what has a flat prior is at its best for any weights.
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
        + float(np.linalg.slogdet(free_block).logabsdet),
    )
    return reduced, block


def restrict(quadratic: Quadratic, kept: Bool[np.ndarray, " parameter"]) -> Quadratic:
    """The sum of squares where all parameters but those in `kept` are zero."""
    change = -quadratic.point[~kept]
    block = quadratic.hessian[np.ix_(~kept, ~kept)]
    border = quadratic.hessian[np.ix_(kept, ~kept)]
    slope = quadratic.gradient[~kept]
    return dataclasses.replace(
        quadratic,
        point=quadratic.point[kept],
        hessian=quadratic.hessian[np.ix_(kept, kept)],
        gradient=quadratic.gradient[kept] + border @ change,
        squares=quadratic.squares + float((2 * slope + block @ change) @ change),
    )


def is_singular(matrix: Float[np.ndarray, "n n"]) -> bool:
    """Whether a normal matrix, its rows and columns scaled, lost all digits."""
    # Scaled to a unit diagonal, so that units do not decide what is singular.
    scale = np.sqrt(np.diag(matrix))
    if not (np.all(np.isfinite(matrix)) and np.all(scale > 0)):
        return True
    if not scale.size:
        return False
    eigenvalues = np.linalg.eigvalsh(matrix / np.outer(scale, scale))
    return bool(eigenvalues[0] < 1e-13 * eigenvalues[-1])


def joint_posterior(
    block: FlatBlock,
    mean: Float[np.ndarray, " weight"],
    covariance: Matrix,
    noise: float,
) -> tuple[Float[np.ndarray, " parameter"], Float[np.ndarray, "parameter parameter"]]:
    """Mean and covariance of all parameters from those of the weights."""
    joint, mask = block.lift(covariance), block.mask
    # At given weights, what has a flat prior is as uncertain as the data leave it.
    joint[np.ix_(mask, mask)] += noise**2 * block.covariance
    offset = np.zeros(len(mask))
    offset[mask] = block.offset
    return offset + block.map_weights() @ mean, joint
