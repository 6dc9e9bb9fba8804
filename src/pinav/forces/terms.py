"""Terms of a structured force: lattices, linear fields, hills, profiles of distances.

`weights` of a term with a profile are the height of its law, if any, then those of the
kernels of the profile [L T⁻²]; `places` and `width` of the kernels [L] are fixed.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector, dimension
from pinav.forces.fitted_laws import FittedLaw
from pinav.forces.priors import (
    AbstractIndependentPrior,
    AbstractPrior,
    Bounds,
    IsotropicPrior,
    LogVariances,
    MixturePrior,
    Shape,
)
from pinav.forces.structures import (
    ROUNDING,
    AbstractProfileTerm,
    AbstractTerm,
    Places,
    distance,
    exponential_of_shear,
)


class LatticePrior(AbstractIndependentPrior):
    r"""Variances of the harmonics of a lattice of orders $m$, $e^{-\lambda^2 |m|^2}$.

    Its shape is $\log\lambda$: the smoother the cell, the larger.
    """

    orders: Any = eqx.field(converter=lambda value: np.asarray(value, float))

    @property
    def start(self) -> Shape:
        return np.zeros(1)

    @property
    def bounds(self) -> Bounds:
        return np.array([[-3.0, 2.0]])

    def log_variances(self, shape: Shape) -> LogVariances:
        squares = np.tile((self.orders**2).sum(axis=1) - 1.0, 2)
        logarithms = -np.exp(2 * shape[0]) * squares
        return logarithms, 2 * logarithms[:, None]


class LatticeTerm(AbstractTerm):
    r"""A force with the periods of a lattice in the plane.

    Its potential is a Fourier series in the phases of two wave vectors,
    $U = \sum_m a_m \cos(m \cdot \phi) + b_m \sin(m \cdot \phi)$ with
    $\phi_i = k_i \cdot (x - x_0)$.

    Attributes:
        weights: $a_m$, then $b_m$ [L² T⁻²].
        wave_vectors: $k_1$ and $k_2$ [rad L⁻¹].
        origin: $x_0$ [L]; fixed.
    """

    weights: Float[Array, " weight"]
    wave_vectors: Float[Array, "2 2"] = eqx.field(metadata=dimension("rad L-1"))
    origin: Float[Array, "2"]
    rotational: bool = eqx.field(static=True, default=False)

    kinds = ("lattice",)
    formulas = (r"-\nabla U(k_1 \cdot x, k_2 \cdot x)",)
    shaped_by = ("wave_vectors",)

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
    """

    weights: Float[Array, " weight"]
    origin: Vector
    scale: Scalar
    rotational: bool = eqx.field(static=True, default=False)

    kinds = ("linear", "rotation")
    formulas = (r"g + S (x - x_0)", r"\omega\,(x - x_0)^\perp")

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


WIDTHS = (0.6, 1.0, 1.7)
"""Widths of the Gaussians that make a hill, relative to its size: a steeper summit, or
a wider foot, than a Gaussian has."""

MIDDLE = WIDTHS.index(1.0)


class HillsPrior(AbstractIndependentPrior):
    r"""Independent heights of the Gaussians of hills, of one variance for each width.

    Its shape is the logarithm of the deviation for each other width, relative to that
    for the middle one: where they are low, hills are Gaussian.
    """

    count: int

    @property
    def start(self) -> Shape:
        return np.full(len(WIDTHS) - 1, -3.0)

    @property
    def bounds(self) -> Bounds:
        return np.tile([-8.0, 1.0], (len(WIDTHS) - 1, 1))

    def log_variances(self, shape: Shape) -> LogVariances:
        slopes = 2 * np.delete(np.eye(len(WIDTHS)), MIDDLE, axis=1)
        return np.tile(slopes @ shape, self.count), np.tile(slopes, (self.count, 1))


class HillsTerm(AbstractTerm):
    r"""Hills and wells in the plane, with similar ellipses for contours.

    $U = \sum_k \sum_m a_{km}\, e^{-|z_k|^2 / 2 b_m^2}$ with
    $z_k = e^{S_k - s_k} (x - c_k)$ and a traceless symmetric $S_k$ of the entries
    $(p_k, q_k)$: $e^{s_k}$ is the geometric mean of the semi-axes, $e^{2|S_k|}$ their
    ratio.

    Attributes:
        weights: $a_{km}$, the Gaussians of a hill one after the other [L² T⁻²].
        centers: $c_k$ [L].
        shapes: $s_k$, the logarithm of a length, then $p_k$ and $q_k$ [1].
    """

    weights: Float[Array, " weight"]
    centers: Float[Array, "hill 2"] = eqx.field(metadata=dimension("L"))
    shapes: Float[Array, "hill 3"] = eqx.field(metadata=dimension("1"))
    rotational: bool = eqx.field(static=True, default=False)

    kinds = ("hills and wells",)
    formulas = (r"-\nabla \sum_k U_k(|A_k (x - c_k)|)",)
    shaped_by = ("centers", "shapes")

    @property
    def geometry_scales(self) -> tuple[float, ...]:
        return 0.5 * self.size, 0.3

    @staticmethod
    def count(numbers: int) -> int:
        """Number of hills with so many numbers in their geometry."""
        return numbers // 5

    @property
    def size(self) -> float:
        """Size of a typical hill [L]."""
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


def _squared_distance(
    x: Vector, center: Float[Array, "2"], shape: Float[Array, "3"]
) -> Float[Array, ""]:
    size, p, q = shape
    metric = exponential_of_shear(2 * p, 2 * q)  # |e^S d|^2 = d e^{2S} d
    offset = x - center
    return jnp.exp(-2 * size) * (offset @ metric @ offset)


class CentralTerm(AbstractProfileTerm):
    r"""A force about a centre, $f(r)\,\hat r$ with $r = |x - c|$, or a swirl.

    Attributes:
        center: $c$ [L].
    """

    weights: Float[Array, " weight"]
    center: Vector = eqx.field(metadata=dimension("L"))
    places: Places
    width: Scalar
    rotational: bool = eqx.field(static=True, default=False)
    law: FittedLaw | None = None

    kinds = ("central", "central swirl")
    formulas = (r"f(|x - c|)\,\hat r", r"f(|x - c|)\,\hat\varphi")
    shaped_by = ("center",)

    def coordinates(self, x: Vector) -> Float[Array, " coordinate"]:
        return distance(x - self.center, ROUNDING * self.width)[None]


class EllipticTerm(AbstractProfileTerm):
    r"""A force whose potential has similar ellipses for contours.

    $z = \sqrt{(x - c)^\top e^{2S} (x - c)}$ with a traceless symmetric $S$:
    $e^{2|S|}$ is the ratio of the axes.

    Attributes:
        center: $c$ [L].
        shear: entries $p$ and $q$ of $S$ [1].
    """

    weights: Float[Array, " weight"]
    center: Float[Array, "2"] = eqx.field(metadata=dimension("L"))
    shear: Float[Array, "2"] = eqx.field(metadata=dimension("1"))
    places: Places
    width: Scalar
    rotational: bool = eqx.field(static=True, default=False)
    law: FittedLaw | None = None

    kinds = ("elliptic",)
    formulas = (r"f(z)\,\nabla z,\ z^2 = (x - c)^\top e^{2S} (x - c)",)
    shaped_by = ("center", "shear")

    def coordinates(self, x: Vector) -> Float[Array, " coordinate"]:
        root = exponential_of_shear(self.shear[0], self.shear[1])
        return distance(root @ (x - self.center), ROUNDING * self.width)[None]


class WallTerm(AbstractProfileTerm):
    r"""A force along one direction that depends on the place along it, $f(z)\,n$.

    $z = n \cdot (x - x_0)$ with $n = (\cos\phi, \sin\phi)$: a wall, a layer, a channel,
    or, turned, a shear flow.

    Attributes:
        angle: $\phi$ of the normal to the x axis [rad].
        origin: $x_0$ [L]; fixed.
    """

    weights: Float[Array, " weight"]
    angle: Float[Array, ""] = eqx.field(
        converter=jnp.asarray, metadata=dimension("rad")
    )
    origin: Float[Array, "2"]
    places: Places
    width: Scalar
    rotational: bool = eqx.field(static=True, default=False)
    law: FittedLaw | None = None

    kinds = ("wall", "shear layer")
    formulas = (r"f(n \cdot x)\,n", r"f(n \cdot x)\,n^\perp")
    shaped_by = ("angle",)
    is_odd = False

    @property
    def offset(self) -> Scalar:
        return self._normal @ self.origin

    def coordinates(self, x: Vector) -> Float[Array, " coordinate"]:
        return (self._normal @ (x - self.origin))[None]

    @property
    def _normal(self) -> Float[Array, "2"]:
        return jnp.stack([jnp.cos(self.angle), jnp.sin(self.angle)])


class ObstaclesTerm(AbstractProfileTerm):
    """Obstacles of one kind: central forces about several centres, one profile.

    Attributes:
        centers: of each obstacle [L].
    """

    weights: Float[Array, " weight"]
    centers: Float[Array, "center dim"] = eqx.field(metadata=dimension("L"))
    places: Places
    width: Scalar
    rotational: bool = eqx.field(static=True, default=False)
    law: FittedLaw | None = None

    kinds = ("obstacles",)
    formulas = (r"\sum_k f(|x - c_k|)\,\hat r_k",)
    shaped_by = ("centers",)

    def coordinates(self, x: Vector) -> Float[Array, " coordinate"]:
        rounding = ROUNDING * self.width
        return jax.vmap(lambda c: distance(x - c, rounding))(self.centers)
