"""Fields that the search has no single hypothesis for: what it should not get wrong.

Sums of three terms, fields without any structure of the search, and swimmers that are
flung out: there must always be a model, not worse than free kernels are.
"""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector
from pinav.forces import (
    AbstractForce,
    AbstractPotentialForce,
    GaussianBarrier,
    LinearForce,
    PlaneWaves,
    SumForce,
    gaussian_swirl,
    soft_wall,
)

Draw = Callable[[np.random.Generator], AbstractForce]


class Patches(AbstractForce):
    """A constant force in each of 5 by 5 squares of side 2 [L T⁻²]."""

    values: Float[Array, "5 5 2"]

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        column, row = jnp.clip(jnp.floor(x / 2).astype(int), 0, 4)
        return self.values[column, row]


class Grooves(AbstractPotentialForce):
    r"""The kinked potential $\sum_i s_i |n_i \cdot (x - c)|$ of crossing grooves."""

    slopes: Float[Array, " groove"]
    normals: Float[Array, "groove 2"]
    center: Float[Array, "2"]

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        return self.slopes @ jnp.abs(self.normals @ (x - self.center))


class Contacts(AbstractPotentialForce):
    r"""Hertz's contact $\tfrac25 k (R_i - |x - c_i|)^{5/2}$ with pillars."""

    stiffness: Float[Array, ""]
    radii: Float[Array, " pillar"]
    centers: Float[Array, "pillar 2"]

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        gaps = x[None] - self.centers
        depths = self.radii - jnp.sqrt((gaps**2).sum(axis=1) + 1e-12)
        return 0.4 * self.stiffness * (jnp.maximum(depths, 0.0) ** 2.5).sum()


class Corridor(AbstractPotentialForce):
    r"""An L-shaped corridor, $k d^2 / 2$ with the distance $d$ beyond its walls.

    It runs along the x axis to a corner and from there along the y axis.
    """

    stiffness: Float[Array, ""]
    corner: Float[Array, "2"]
    half_width: Float[Array, ""]

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        right, up = x - self.corner
        along_x = jnp.hypot(jnp.maximum(right, 0.0), up)
        along_y = jnp.hypot(right, jnp.minimum(up, 0.0))
        distance = jnp.minimum(along_x, along_y)
        beyond = jnp.maximum(distance - self.half_width, 0.0)
        return self.stiffness * beyond**2 / 2


def _hill(rng: np.random.Generator) -> AbstractForce:
    place = rng.uniform(2.5, 7.5, 2)
    width = float(rng.uniform(0.7, 1.0))
    return GaussianBarrier(float(rng.uniform(3.0, 5.0)), place, width)


def _three_terms(rng: np.random.Generator) -> AbstractForce:
    angle = float(rng.uniform(0.0, 2 * np.pi))
    offset = 5.0 * (np.cos(angle) + np.sin(angle)) + float(rng.uniform(2.0, 4.0))
    wall = soft_wall(4.0, angle, float(offset), float(rng.uniform(0.4, 0.8)))
    first, second = _hill(rng), _hill(rng)
    return SumForce((first, second, wall))


def _contacts(rng: np.random.Generator) -> AbstractForce:
    turn = rng.uniform(0.0, 2 * np.pi)
    angles = turn + np.pi * np.arange(2) + rng.uniform(-0.5, 0.5, 2)
    centers = 5.0 + 2.2 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    radii = rng.uniform(1.5, 3.0, 2)
    stiffness = float(rng.uniform(1.0, 2.0))
    return Contacts(jnp.asarray(stiffness), jnp.asarray(radii), jnp.asarray(centers))


def _kinks(rng: np.random.Generator) -> AbstractForce:
    angles = rng.uniform(0.0, np.pi) + np.array([0.0, rng.uniform(0.7, 2.0)])
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    slopes, center = rng.uniform(0.2, 0.8, 2), rng.uniform(4.0, 6.0, 2)
    return Grooves(jnp.asarray(slopes), jnp.asarray(normals), jnp.asarray(center))


def _patches(rng: np.random.Generator) -> AbstractForce:
    return Patches(jnp.asarray(rng.normal(size=(5, 5, 2))))


def _corridor(rng: np.random.Generator) -> AbstractForce:
    numbers = rng.uniform([1.0, 5.0, 4.0, 0.8], [3.0, 8.0, 6.0, 1.6])
    stiffness, across, up, half_width = map(jnp.asarray, numbers)
    return Corridor(stiffness, jnp.stack([across, up]), half_width)


def _vortex_pair(rng: np.random.Generator) -> AbstractForce:
    angle, width = rng.uniform(0.0, 2 * np.pi), float(rng.uniform(1.0, 1.6))
    half = 1.7 * np.array([np.cos(angle), np.sin(angle)])
    strengths = rng.uniform(1.5, 3.0, 2) * np.array([1.0, -1.0])
    pair = zip(strengths, (5.0 + half, 5.0 - half), strict=True)
    return SumForce(tuple(gaussian_swirl(float(s), at, width) for s, at in pair))


def _two_harmonics(rng: np.random.Generator) -> AbstractForce:
    angle, period = rng.uniform(0.0, np.pi), rng.uniform(4.0, 6.0)
    along = 2 * np.pi / period * np.array([np.cos(angle), np.sin(angle)])
    vectors = np.stack([along, 2 * along, 1.4 * np.array([-along[1], along[0]])])
    return PlaneWaves(rng.uniform(0.3, 0.8, 3), vectors, rng.uniform(0, 2 * np.pi, 3))


def _defect(rng: np.random.Generator) -> AbstractForce:
    angle, period = rng.uniform(0.0, np.pi / 2), rng.uniform(4.0, 6.0)
    along = 2 * np.pi / period * np.array([np.cos(angle), np.sin(angle)])
    vectors = np.stack([along, [-along[1], along[0]]])
    amplitudes = np.full(2, rng.uniform(0.6, 1.0))
    lattice = PlaneWaves(amplitudes, vectors, rng.uniform(0.0, 2 * np.pi, 2))
    return SumForce((lattice, _hill(rng)))


class Shear(AbstractForce):
    """A force along a wall, as far as its layer reaches, that waves along x."""

    size: Float[Array, ""]
    depth: Float[Array, ""]
    wave_number: Float[Array, ""]

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        along = self.size * jnp.exp(-(((x[1] - 5.0) / self.depth) ** 2))
        across = 0.3 * self.size * jnp.sin(self.wave_number * x[0])
        return jnp.stack([along, across])


def _shear(rng: np.random.Generator) -> AbstractForce:
    numbers = rng.uniform([0.3, 1.0, 0.8], [0.8, 2.5, 1.6])
    return Shear(*map(jnp.asarray, numbers))


def _flung_vortex(rng: np.random.Generator) -> AbstractForce:
    """A vortex in a saddle that flings swimmers out over a hundred lengths."""
    rate, place = float(rng.uniform(0.06, 0.12)), rng.uniform(4.0, 6.0, 2)
    saddle = LinearForce(np.diag([rate, -rate]), place)
    strength, width = float(rng.uniform(2.0, 4.0)), float(rng.uniform(1.5, 2.5))
    return SumForce((gaussian_swirl(strength, place, width), saddle))


OUTSIDE: dict[str, Draw] = {
    "two-hills-wall": _three_terms,
    "contacts": _contacts,
    "kinks": _kinks,
    "patches": _patches,
    "corridor": _corridor,
    "vortex-pair": _vortex_pair,
    "two-harmonics": _two_harmonics,
    "defect": _defect,
    "shear": _shear,
    "flung-vortex": _flung_vortex,
}
"""Fields by their names, in the order on which their draws depend."""
