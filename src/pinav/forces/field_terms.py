"""Terms that fill space: periodic lattices and linear fields."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar, Vector
from pinav.forces.priors import (
    AbstractPrior,
    IsotropicPrior,
    Matrix,
    MixturePrior,
    Shape,
)
from pinav.forces.structures import AbstractTerm, quarter_turn


class LatticePrior(AbstractPrior):
    r"""Variances of the harmonics of a lattice, $e^{-\lambda^2 |m|^2}$.

    Its shape is $\log\lambda$: the smoother the cell, the larger.

    Attributes:
        orders: $m$ of the harmonics.
    """

    orders: Any = eqx.field(converter=lambda value: np.asarray(value, float))

    @property
    def start(self) -> Shape:
        return np.zeros(1)

    @property
    def bounds(self) -> Float[np.ndarray, "shape 2"]:
        return np.array([[-3.0, 2.0]])

    def covariance(self, shape: Shape) -> Matrix:
        return np.diag(np.exp(-np.exp(2 * shape[0]) * self._squares))

    def pullback(self, shape: Shape, pull: Matrix) -> Shape:
        logarithms = -np.exp(2 * shape[0]) * self._squares
        by_variance = np.diagonal(pull) * np.exp(logarithms)
        return np.array([2 * by_variance @ logarithms])

    @property
    def _squares(self) -> Float[np.ndarray, " weight"]:
        squares = (self.orders**2).sum(axis=1) - 1.0
        return np.concatenate([squares, squares])


class LatticeTerm(AbstractTerm):
    r"""A force with the periods of a lattice in the plane.

    Its potential is a Fourier series in the phases of two wave vectors,
    $U = \sum_m a_m \cos(m \cdot \phi) + b_m \sin(m \cdot \phi)$ with
    $\phi_i = k_i \cdot (x - x_0)$.

    Attributes:
        weights: $a_m$, then $b_m$ [L² T⁻²].
        wave_vectors: $k_1$ and $k_2$ [rad L⁻¹].
        origin: $x_0$ [L]; fixed.
        rotational: whether the series is a stream function.
    """

    weights: Float[Array, " weight"]
    wave_vectors: Float[Array, "2 2"]
    origin: Float[Array, "2"]
    rotational: bool = eqx.field(static=True, default=False)

    @property
    def kind(self) -> str:
        return "lattice"

    @property
    def latex(self) -> str:
        return r"-\nabla U(k_1 \cdot x, k_2 \cdot x)"

    @property
    def geometry(self) -> PyTree:
        return (self.wave_vectors,)

    @property
    def geometry_scales(self) -> tuple[float, ...]:
        return (float(np.linalg.norm(self.wave_vectors, axis=1).mean()),)

    @property
    def force_per_weight(self) -> float:
        return float(np.mean(np.linalg.norm(self.wave_vectors, axis=1)))

    def prior(self) -> LatticePrior:
        return LatticePrior(HARMONICS)

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        phases = jnp.asarray(HARMONICS, float) @ (self.wave_vectors @ (x - self.origin))
        return jnp.concatenate([jnp.cos(phases), jnp.sin(phases)]) @ self.weights

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        force = -jax.grad(self.potential, argnums=1)(t, x)
        return quarter_turn(force) if self.rotational else force


HARMONICS = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2))
"""Orders of the harmonics of a lattice."""


class LinearTerm(AbstractTerm):
    r"""A force that is linear in the place: uniform, a saddle, a trap; or a rotation.

    $U = -g \cdot z - \tfrac12 z^\top S z$ with $z = (x - x_0) / s$; a rotational term
    is $\psi = -\tfrac12 \omega |z|^2$ alone.

    Attributes:
        weights: $g$, then the upper half of $S$, row by row; or $\omega$ [L² T⁻²].
        origin: $x_0$ [L]; fixed.
        scale: $s$ [L]; fixed.
        rotational: a rigid rotation.
    """

    weights: Float[Array, " weight"]
    origin: Vector
    scale: Scalar
    rotational: bool = eqx.field(static=True, default=False)

    @property
    def kind(self) -> str:
        return "rotation" if self.rotational else "linear"

    @property
    def latex(self) -> str:
        return r"\omega\,(x - x_0)^\perp" if self.rotational else r"g + S (x - x_0)"

    @property
    def geometry(self) -> PyTree:
        return ()

    @property
    def geometry_scales(self) -> tuple[float, ...]:
        return ()

    @property
    def force_per_weight(self) -> float:
        return 1 / float(self.scale)

    def prior(self) -> AbstractPrior:
        """Either part may be all there is: a uniform force has no slope."""
        dim = self.origin.shape[0]
        if self.rotational:
            return IsotropicPrior(1)
        return MixturePrior(IsotropicPrior(dim), IsotropicPrior(dim * (dim + 1) // 2))

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        place = (x - self.origin) / self.scale
        if self.rotational:
            return -0.5 * self.weights[0] * (place @ place)
        upper = jnp.outer(place, place)[jnp.triu_indices(place.shape[0])]
        return -self.weights @ jnp.concatenate([place, 0.5 * upper])

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        force = -jax.grad(self.potential, argnums=1)(t, x)
        return quarter_turn(force) if self.rotational else force
