r"""Terms of a force that has a structure: a profile of coordinates, and what shapes it.

A term is $F(x) = \sum_m f(z_m(x))\, \nabla z_m$ with coordinates $z_m$ that depend on
few numbers (a centre, an angle, the ends of a segment), its geometry, and a profile
$f(z) = \sum_j w_j\, k(z - \rho_j)$ of Gaussian kernels. It is the profile of the force,
not of the potential: where there are no data its mean is no force. A rotational term
is turned by a right angle, which makes a stream function of the potential. Where $z$ is
a distance the profile is odd in it, so that the force vanishes at distance zero.

References:
    Duvenaud, Nickisch and Rasmussen, NeurIPS 2011, additive processes; van der Wilk,
    Bauer, John and Hensman, NeurIPS 2018, invariances by the marginal likelihood.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar, Vector
from pinav.errors import InputError
from pinav.forces.force import AbstractForce
from pinav.forces.priors import (
    AbstractPrior,
    DistancePrior,
    IsotropicPrior,
    WeightPrior,
)

Places = Float[Array, " kernel"]
"""Places of the kernels of a profile [L]."""

ROUNDING = 1e-3
"""Distance, in widths of a kernel, within which the distance to a point is rounded: its
derivative at the point itself would not exist."""


class AbstractTerm(AbstractForce):
    """A part of a force that is linear in its weights, given its geometry.

    Attributes:
        weights: what has a Gaussian prior.
        rotational: whether the force is turned by a right angle.
    """

    weights: eqx.AbstractVar[Float[Array, " weight"]]
    rotational: eqx.AbstractVar[bool]

    @property
    @abc.abstractmethod
    def kind(self) -> str:
        """The word for it in tables."""

    @property
    @abc.abstractmethod
    def latex(self) -> str:
        """Its formula."""

    @property
    @abc.abstractmethod
    def geometry(self) -> PyTree:
        """The numbers with a flat prior."""

    @abc.abstractmethod
    def prior(self) -> AbstractPrior:
        """Prior of the weights."""

    @abc.abstractmethod
    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        """Potential energy per mass, or the stream function of a rotational term."""


class AbstractProfileTerm(AbstractTerm):
    """A term with a profile of one coordinate, or of several that share it.

    Attributes:
        places: of the kernels in the coordinate [L]; fixed.
        width: of a kernel [L]; fixed.
    """

    places: eqx.AbstractVar[Places]
    width: eqx.AbstractVar[Scalar]

    @property
    @abc.abstractmethod
    def is_odd(self) -> bool:
        """Whether the profile is odd, as a distance asks for."""

    @abc.abstractmethod
    def coordinates(self, x: Vector) -> Float[Array, " coordinate"]:
        """The coordinates that share the profile [L]."""

    def profile(self, z: Scalar) -> Float[Array, ""]:
        """The force along the coordinate at `z` [L T⁻²]."""
        return profile_kernels(self, z) @ self.weights

    def prior(self) -> AbstractPrior:
        base = WeightPrior(np.asarray(self.places)[:, None], float(self.width))
        return DistancePrior(base) if self.is_odd else base

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        def height(z: Scalar) -> Float[Array, ""]:
            scale = self.width * np.sqrt(np.pi / 2)
            erf = jax.scipy.special.erf
            root = np.sqrt(2.0) * self.width
            rise = erf((z - self.places) / root) + erf(self.places / root)
            if self.is_odd:
                mirrored = erf((z + self.places) / root) - erf(self.places / root)
                rise = rise - mirrored
            return -scale * (rise @ self.weights)

        return jnp.sum(jax.vmap(height)(self.coordinates(x)))

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        z, pull = jax.vjp(self.coordinates, x)
        (force,) = pull(jax.vmap(self.profile)(z))
        return quarter_turn(force) if self.rotational else force


def profile_kernels(term: AbstractProfileTerm, z: Scalar) -> Float[Array, " kernel"]:
    """Values of the kernels of a profile at `z`, odd where the profile is."""
    values = jnp.exp(-0.5 * ((z - term.places) / term.width) ** 2)
    if term.is_odd:
        values = values - jnp.exp(-0.5 * ((z + term.places) / term.width) ** 2)
    return values


def quarter_turn(force: Float[Array, "2"]) -> Float[Array, "2"]:
    r"""$(\partial_y\psi, -\partial_x\psi)$ of a force that would be $-\nabla\psi$."""
    return jnp.stack([-force[1], force[0]])


def distance(offset: Vector, rounding: Scalar) -> Float[Array, ""]:
    """Length of a vector, smooth at zero."""
    return jnp.sqrt(offset @ offset + rounding**2)


class CentralTerm(AbstractProfileTerm):
    r"""A force about a centre, $f(r)\,\hat r$ with $r = |x - c|$, or a swirl about it.

    Attributes:
        weights: $w_j$ of the profile [L T⁻²].
        center: $c$ [L].
        places: of the kernels [L]; fixed.
        width: of a kernel [L]; fixed.
        rotational: a swirl, in the plane alone.
    """

    weights: Float[Array, " kernel"]
    center: Vector
    places: Places
    width: Scalar
    rotational: bool = eqx.field(static=True, default=False)

    @property
    def kind(self) -> str:
        return "central swirl" if self.rotational else "central"

    @property
    def latex(self) -> str:
        return r"f(|x - c|)\,\hat\varphi" if self.rotational else r"f(|x - c|)\,\hat r"

    @property
    def geometry(self) -> PyTree:
        return (self.center,)

    @property
    def is_odd(self) -> bool:
        return True

    def coordinates(self, x: Vector) -> Float[Array, " coordinate"]:
        return distance(x - self.center, ROUNDING * self.width)[None]


class EllipticTerm(AbstractProfileTerm):
    r"""A force whose potential has similar ellipses for contours.

    $z = \sqrt{(x - c)^\top e^{2S} (x - c)}$ with a traceless symmetric $S$ of the
    entries $(p, q)$: $e^{2|S|}$ is the ratio of the axes.

    Attributes:
        weights: $w_j$ of the profile [L T⁻²].
        center: $c$ [L].
        shear: $p$ and $q$.
        places: of the kernels [L]; fixed.
        width: of a kernel [L]; fixed.
        rotational: whether $z$ shapes a stream function.
    """

    weights: Float[Array, " kernel"]
    center: Float[Array, "2"]
    shear: Float[Array, "2"]
    places: Places
    width: Scalar
    rotational: bool = eqx.field(static=True, default=False)

    @property
    def kind(self) -> str:
        return "elliptic"

    @property
    def latex(self) -> str:
        return r"f(z)\,\nabla z,\ z^2 = (x - c)^\top e^{2S} (x - c)"

    @property
    def geometry(self) -> PyTree:
        return self.center, self.shear

    @property
    def is_odd(self) -> bool:
        return True

    def coordinates(self, x: Vector) -> Float[Array, " coordinate"]:
        p, q = self.shear[0], self.shear[1]
        size = jnp.sqrt(p**2 + q**2 + 1e-12)  # smooth where the ellipse is a circle
        bent = jnp.stack([jnp.stack([p, q]), jnp.stack([q, -p])])
        root = jnp.cosh(size) * jnp.eye(2) + jnp.sinh(size) / size * bent
        return distance(root @ (x - self.center), ROUNDING * self.width)[None]


class WallTerm(AbstractProfileTerm):
    r"""A force along one direction that depends on the place along it, $f(z)\,n$.

    $z = n \cdot (x - x_0)$ with $n = (\cos\phi, \sin\phi)$: a wall, a layer, a channel,
    or, turned, a shear flow.

    Attributes:
        weights: $w_j$ of the profile [L T⁻²].
        angle: $\phi$ of the normal to the x axis [rad].
        origin: $x_0$ [L]; fixed.
        places: of the kernels [L]; fixed.
        width: of a kernel [L]; fixed.
        rotational: the force is along the layers.
    """

    weights: Float[Array, " kernel"]
    angle: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    origin: Float[Array, "2"]
    places: Places
    width: Scalar
    rotational: bool = eqx.field(static=True, default=False)

    @property
    def kind(self) -> str:
        return "shear layer" if self.rotational else "wall"

    @property
    def latex(self) -> str:
        normal = r"n^\perp" if self.rotational else "n"
        return rf"f(n \cdot x)\,{normal}"

    @property
    def geometry(self) -> PyTree:
        return (self.angle,)

    @property
    def is_odd(self) -> bool:
        return False

    def coordinates(self, x: Vector) -> Float[Array, " coordinate"]:
        normal = jnp.stack([jnp.cos(self.angle), jnp.sin(self.angle)])
        return (normal @ (x - self.origin))[None]


class SegmentTerm(AbstractProfileTerm):
    r"""A force away from a segment: a fibre with round ends.

    Attributes:
        weights: $w_j$ of the profile [L T⁻²].
        ends: of the segment [L].
        places: of the kernels [L]; fixed.
        width: of a kernel [L]; fixed.
        rotational: a swirl about the segment.
    """

    weights: Float[Array, " kernel"]
    ends: Float[Array, "2 2"]
    places: Places
    width: Scalar
    rotational: bool = eqx.field(static=True, default=False)

    @property
    def kind(self) -> str:
        return "segment"

    @property
    def latex(self) -> str:
        return r"f(z)\,\nabla z,\ z = \mathrm{dist}(x, \overline{ab})"

    @property
    def geometry(self) -> PyTree:
        return (self.ends,)

    @property
    def is_odd(self) -> bool:
        return True

    def coordinates(self, x: Vector) -> Float[Array, " coordinate"]:
        along = self.ends[1] - self.ends[0]
        length = along @ along + (ROUNDING * self.width) ** 2
        fraction = jnp.clip((x - self.ends[0]) @ along / length, 0.0, 1.0)
        offset = x - self.ends[0] - fraction * along
        return distance(offset, ROUNDING * self.width)[None]


class ObstaclesTerm(AbstractProfileTerm):
    r"""Obstacles of one kind: central forces about several centres, one profile.

    Attributes:
        weights: $w_j$ of the profile [L T⁻²].
        centers: $c_k$ [L].
        places: of the kernels [L]; fixed.
        width: of a kernel [L]; fixed.
        rotational: swirls of one kind.
    """

    weights: Float[Array, " kernel"]
    centers: Float[Array, "center dim"]
    places: Places
    width: Scalar
    rotational: bool = eqx.field(static=True, default=False)

    @property
    def kind(self) -> str:
        return "obstacles"

    @property
    def latex(self) -> str:
        return r"\sum_k f(|x - c_k|)\,\hat r_k"

    @property
    def geometry(self) -> PyTree:
        return (self.centers,)

    @property
    def is_odd(self) -> bool:
        return True

    def coordinates(self, x: Vector) -> Float[Array, " coordinate"]:
        rounding = ROUNDING * self.width
        return jax.vmap(lambda c: distance(x - c, rounding))(self.centers)


class LatticePrior(AbstractPrior):
    r"""Variances of the harmonics of a lattice, $e^{-\lambda^2 |m|^2}$.

    Its shape is $\log\lambda$: the smoother the cell, the larger.

    Attributes:
        orders: $m$ of the harmonics.
    """

    orders: Any = eqx.field(converter=lambda value: np.asarray(value, float))

    @property
    def start(self) -> Float[np.ndarray, " shape"]:
        return np.zeros(1)

    @property
    def bounds(self) -> Float[np.ndarray, "shape 2"]:
        return np.array([[-3.0, 2.0]])

    def covariance(
        self, shape: Float[np.ndarray, " shape"]
    ) -> Float[np.ndarray, "weight weight"]:
        return np.diag(np.exp(-np.exp(2 * shape[0]) * self._squares))

    def slopes(
        self, shape: Float[np.ndarray, " shape"]
    ) -> Float[np.ndarray, "shape weight weight"]:
        factor = -2 * np.exp(2 * shape[0]) * self._squares
        return (self.covariance(shape) * factor)[None]

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

    def prior(self) -> IsotropicPrior:
        dim = self.origin.shape[0]
        return IsotropicPrior(1 if self.rotational else dim + dim * (dim + 1) // 2)

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        place = (x - self.origin) / self.scale
        if self.rotational:
            return -0.5 * self.weights[0] * (place @ place)
        upper = jnp.outer(place, place)[jnp.triu_indices(place.shape[0])]
        return -self.weights @ jnp.concatenate([place, 0.5 * upper])

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        force = -jax.grad(self.potential, argnums=1)(t, x)
        return quarter_turn(force) if self.rotational else force


def check_rotation(term: AbstractTerm, dim: int) -> None:
    """Refuse a rotational term outside of the plane.

    Raises:
        InputError: `dim` is not two.
    """
    if term.rotational and dim != 2:
        raise InputError(
            f"{type(term).__name__}.rotational: expected a plane, got dimension {dim}"
        )
