"""Forces and potentials that are sums of Gaussian kernels."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.forces.force import AbstractLearnedForce
from pinav.forces.priors import WeightPrior


class KernelForce(AbstractLearnedForce):
    r"""Free force field $F(x) = \sum_j w_j \exp(-|x - c_j|^2 / 2 b^2)$.

    Linear in its weights. With a Gaussian prior on them it is a Gaussian process:
    far from the centres the force is zero and its uncertainty that of the prior.

    Attributes:
        weights: $w_j$ [L T⁻²], what trains.
        centers: $c_j$ [L]; fixed.
        width: $b$ [L], positive; fixed.

    Raises:
        InputError: shapes disagree, or `width` is a number <= 0.
    """

    weights: Float[Array, "kernel dim"]
    centers: Float[Array, "kernel dim"]
    width: Scalar

    def __check_init__(self) -> None:
        check_kernels(self, np.shape(self.centers))

    @classmethod
    def untrained(
        cls, centers: Float[np.ndarray, "kernel dim"], width: float
    ) -> "KernelForce":
        """A force field without weight yet: kernels at places, of a width [L]."""
        places = jnp.asarray(centers)
        return cls(jnp.zeros_like(places), places, width)

    @property
    def parameters(self):
        return self.weights

    @property
    def dim(self):
        return self.centers.shape[1]

    @property
    def kernels(self):
        return self

    def length_scales(self, shape):
        return [float(np.exp(shape[0]))]

    def prior(self):
        return WeightPrior(self.centers, self.width, self.dim)

    def kernels_on(self, centers, width):
        return KernelForce.untrained(centers, width)

    def __call__(self, t, x, v):
        return kernel_values(x, self.centers, self.width) @ self.weights


class KernelPotential(AbstractLearnedForce):
    r"""Conservative force $-\nabla U$, $U(x) = \sum_j w_j \exp(-|x - c_j|^2 / 2 b^2)$.

    Attributes:
        weights: $w_j$ [L² T⁻²], what trains.
        centers: $c_j$ [L]; fixed.
        width: $b$ [L], positive; fixed.

    Raises:
        InputError: shapes disagree, or `width` is a number <= 0.
    """

    weights: Float[Array, " kernel"]
    centers: Float[Array, "kernel dim"]
    width: Scalar

    def __check_init__(self) -> None:
        check_kernels(self, np.shape(self.centers)[:1])

    @classmethod
    def untrained(
        cls, centers: Float[np.ndarray, "kernel dim"], width: float
    ) -> "KernelPotential":
        """A potential without weight yet: kernels at places, of a width [L]."""
        places = jnp.asarray(centers)
        return cls(jnp.zeros(len(places)), places, width)

    @property
    def parameters(self):
        return self.weights

    @property
    def dim(self):
        return self.centers.shape[1]

    @property
    def kernels(self):
        return self

    def length_scales(self, shape):
        return [float(np.exp(shape[0]))]

    def prior(self):
        return WeightPrior(self.centers, self.width)

    def kernels_on(self, centers, width):
        return KernelPotential.untrained(centers, width)

    def potential(self, t: Scalar, x: Float[Array, " dim"]) -> Float[Array, ""]:
        """Potential energy per mass $U(x)$ [L² T⁻²]."""
        return self.weights @ kernel_values(x, self.centers, self.width)

    def __call__(self, t, x, v):
        strengths = self.weights * kernel_values(x, self.centers, self.width)
        return strengths @ (x[None] - self.centers) / self.width**2


def kernel_centers(
    positions: Float[np.ndarray, "sample dim"], *, spacing: float, margin: float
) -> Float[np.ndarray, "kernel dim"]:
    """Points of a square grid that lie within `margin` of an observed position.

    Args:
        positions: observed positions [L].
        spacing: of the grid [L], positive.
        margin: distance from the data [L] up to which there are kernels, positive.

    Raises:
        InputError: `spacing` or `margin` is not positive.
    """
    for name, value in (("spacing", spacing), ("margin", margin)):
        if not value > 0:
            raise InputError(f"kernel_centers {name}: expected > 0, got {value}")
    from scipy.spatial import KDTree

    low, high = positions.min(axis=0) - margin, positions.max(axis=0) + margin
    axes = [np.arange(a, b + spacing, spacing) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    points = grid.reshape(-1, positions.shape[1])
    return points[KDTree(positions).query(points)[0] < margin]


def kernel_values(
    x: Float[Array, " dim"], centers: Float[Array, "kernel dim"], width: Scalar
) -> Float[Array, " kernel"]:
    r"""Radial basis functions $\exp(-|x - c_j|^2 / 2 b^2)$ at one point."""
    offsets = (x[None] - centers) / width
    return jnp.exp(-0.5 * jnp.sum(offsets**2, axis=1))


def check_kernels(force: Any, expected: tuple[int, ...]) -> None:
    """Raise `InputError` where its weights have not the shape `expected`."""
    name = type(force).__name__
    if np.shape(force.weights) != expected:
        raise InputError(
            f"{name}.weights: expected shape {expected}, as the centers have, got "
            f"{np.shape(force.weights)}"
        )
    if isinstance(force.width, float | int) and force.width <= 0:
        raise InputError(f"{name}.width: expected > 0, got {force.width}")
