"""Hills and wells, each of a place, a height and a shape of its own."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar, Vector
from pinav.forces.priors import AbstractPrior, Matrix, Shape
from pinav.forces.structures import AbstractTerm, exponential_of_shear, quarter_turn

WIDTHS = (0.6, 1.0, 1.7)
"""Widths of the Gaussians that make a hill, relative to its size: a steeper summit, or
a wider foot, than a Gaussian has."""

MIDDLE = WIDTHS.index(1.0)


class HillsPrior(AbstractPrior):
    r"""Independent heights of the Gaussians of hills, of one variance for each width.

    Its shape is the logarithm of the deviation for each other width, relative to that
    for the middle one: where they are low, hills are Gaussian.

    Attributes:
        count: of the hills.
    """

    count: int

    @property
    def start(self) -> Shape:
        return np.full(len(WIDTHS) - 1, -3.0)

    @property
    def bounds(self) -> Float[np.ndarray, "shape 2"]:
        return np.tile([-8.0, 1.0], (len(WIDTHS) - 1, 1))

    def covariance(self, shape: Shape) -> Matrix:
        return np.diag(np.tile(_variances(shape), self.count))

    def pullback(self, shape: Shape, pull: Matrix) -> Shape:
        sums = np.diagonal(pull).reshape(self.count, -1).sum(axis=0)
        return np.delete(2 * sums * _variances(shape), MIDDLE)


def _variances(shape: Shape) -> Float[np.ndarray, " width"]:
    return np.exp(2 * np.insert(np.asarray(shape), MIDDLE, 0.0))


class HillsTerm(AbstractTerm):
    r"""Hills and wells in the plane, with similar ellipses for contours.

    $U = \sum_k \sum_m a_{km}\, e^{-|z_k|^2 / 2 b_m^2}$ with
    $z_k = e^{S_k - s_k} (x - c_k)$ and a traceless symmetric $S_k$ of the entries
    $(p_k, q_k)$: $e^{s_k}$ is the geometric mean of the semi-axes, $e^{2|S_k|}$ their
    ratio.

    Attributes:
        weights: $a_{km}$, the Gaussians of a hill one after the other [L² T⁻²].
        centers: $c_k$ [L].
        shapes: $s_k$, the logarithm of a length [L], then $p_k$ and $q_k$.
        rotational: swirls in place of hills.
    """

    weights: Float[Array, " weight"]
    centers: Float[Array, "hill 2"]
    shapes: Float[Array, "hill 3"]
    rotational: bool = eqx.field(static=True, default=False)

    KIND: ClassVar[str] = "hills and wells"

    @property
    def kind(self) -> str:
        return self.KIND

    @property
    def latex(self) -> str:
        return r"-\nabla \sum_k U_k(|A_k (x - c_k)|)"

    @property
    def geometry(self) -> PyTree:
        return self.centers, self.shapes

    @property
    def geometry_scales(self) -> tuple[float, ...]:
        return 0.5 * self.size, 0.3

    @staticmethod
    def count(numbers: int) -> int:
        """How many hills have so many numbers in their geometry."""
        return numbers // 5

    @property
    def gaps(self) -> Float[np.ndarray, " hill"]:
        """Distance of the nearest other place from each hill, in its own sizes."""
        from_each = jax.vmap(_squared_distance, (None, 0, 0))
        squares = jax.vmap(from_each, (0, None, None))(
            self.centers, self.centers, self.shapes
        )
        distances = np.sqrt(np.asarray(squares))
        np.fill_diagonal(distances, np.inf)
        return distances.min(axis=0)

    @property
    def size(self) -> float:
        """Of a typical hill [L]."""
        return float(np.exp(np.median(np.asarray(self.shapes)[:, 0])))

    @property
    def force_per_weight(self) -> float:
        return 1 / self.size

    def prior(self) -> HillsPrior:
        return HillsPrior(len(self.centers))

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        squares = jax.vmap(_squared_distance, (None, 0, 0))(
            x, self.centers, self.shapes
        )
        exponents = -0.5 * squares[:, None] / jnp.asarray(WIDTHS)[None] ** 2
        return jnp.ravel(jnp.exp(exponents)) @ self.weights

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        force = -jax.grad(self.potential, argnums=1)(t, x)
        return quarter_turn(force) if self.rotational else force


def _squared_distance(
    x: Vector, center: Float[Array, "2"], shape: Float[Array, "3"]
) -> Float[Array, ""]:
    size, p, q = shape
    metric = exponential_of_shear(2 * p, 2 * q)  # |e^S d|^2 = d e^{2S} d
    offset = x - center
    return jnp.exp(-2 * size) * (offset @ metric @ offset)
