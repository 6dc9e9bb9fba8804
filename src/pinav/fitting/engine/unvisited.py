r"""The force on unvisited ground: as large and as rough as that on visited ground.

The prior of a fit has an envelope, which the data choose where they are. Where they are
not it states what nobody has seen, and a band by that prior alone is narrowest where
nobody has been. So each part of a learned force has, beside the posterior, a stationary
process that is zero at the visited places:

$$\operatorname{var} F(x) = A^2\,(1 - k(x, X)\, k(X, X)^{-1} k(X, x)),$$

with the mean square $A^2$ of the part on visited ground, the places $X$, and Matern's
correlation $k$ of order 5/2, whose length $\ell$ follows from the mean square of the
gradient, $\overline{|\nabla F_i|^2} = \tfrac53 d A^2 / \ell^2$ in $d$ dimensions. The
force of a term with a profile is such a process in the coordinate of the profile; about
a centre that nobody reached it may go on as it does at the least visited distance, or
bend, so that the distance between the two is one standard deviation more.

References:
    Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), sections 2.2
    and 4.2; Rahimi and Recht, Advances in Neural Information Processing Systems 20
    (2007); Wilson et al., Journal of Machine Learning Research 22, 105 (2021).
"""

import abc
from collections.abc import Callable, Iterator
from operator import attrgetter
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector, on_device
from pinav.forces import AbstractForce, AbstractLearnedForce, split_structure
from pinav.forces.kernels import quarter_turn
from pinav.forces.structures import AbstractProfileTerm
from pinav.forces.terms import HillsTerm

MOST_PLACES = 1000
"""Visited places that are kept; their correlations are factorised."""

APART = 0.1
"""Least distance between visited places, as a share of the length over which forces
change."""

MOST_ROUGH = 1e6
"""Largest roughness, relative to that of one change over the extent of the data."""

NUGGET = 1e-9
"""Variance of the process at visited places, relative to that elsewhere: numerics."""

WAVES = 128
"""Waves of which a draw is made."""

WIDER = (1.0, 3.0, 9.0)
"""Factors of the wave numbers that are drawn equally often."""

AT_ONCE = 2000
"""Points whose variance is computed in one call."""

Places = Float[np.ndarray, "place dim"]
"""Places [L], or values of a coordinate, one a row."""


class Ground(eqx.Module):
    r"""A process like a field where somebody has been, and zero at these places.

    Attributes:
        places: $X$ [L].
        size: $A$, root mean square of a component of the field.
        length: $\ell$ [L].
        factor: lower Cholesky factor of the correlations of the places.
    """

    places: Places
    size: float
    length: float
    factor: Float[np.ndarray, "place place"]

    @classmethod
    def of(
        cls,
        force: AbstractForce,
        visited: Places,
        variance: Float[np.ndarray, "some component"] | float = 0.0,
    ) -> "Ground":
        """The process of a force, or of the profile of a term, at visited places.

        Args:
            variance: of what is known of the force there.
        """
        extent = _extent(visited)
        some = on_device(thin(visited, extent / np.sqrt(MOST_PLACES)))
        values, gradients = map(np.asarray, _values_and_gradients(force, some))
        squares, steepness = np.sum(values**2), np.sum(gradients**2)
        # A force that is the same everywhere may change over the extent of the data.
        roughness = 0.6 * steepness / max(squares, np.finfo(float).tiny)
        least = visited.shape[1] / extent**2
        roughness = np.clip(roughness, least, MOST_ROUGH * least)
        length = np.sqrt(visited.shape[1] / roughness)
        places = thin(visited, APART * length)
        alike = _correlation(places, places, length) + NUGGET * np.eye(len(places))
        size = float(np.sqrt(np.mean(values**2) + np.mean(variance)))
        return cls(places, size, float(length), np.linalg.cholesky(alike))

    def variance(
        self, points: Float[np.ndarray, "point dim"]
    ) -> Float[np.ndarray, " point"]:
        """Variance of each component at points."""
        parts = []
        for begin in range(0, len(points), AT_ONCE):
            some = _correlation(
                self.places, points[begin : begin + AT_ONCE], self.length
            )
            known = scipy.linalg.solve_triangular(self.factor, some, lower=True)
            parts.append(1.0 - np.sum(known**2, axis=0))
        return self.size**2 * np.maximum(np.concatenate([np.zeros(0), *parts]), 0.0)

    def draw(self, components: int, generator: np.random.Generator) -> "DrawnField":
        """One draw of the process: waves, less what they are at the places."""
        waves, shares = _matern_waves(self.places.shape[1], generator)
        waves, phases = waves / self.length, generator.uniform(0.0, 2 * np.pi, WAVES)
        heights = generator.normal(size=(WAVES, components))
        heights *= np.sqrt(2 * shares / WAVES)[:, None]
        there = np.cos(self.places @ waves.T + phases) @ heights
        pulls = scipy.linalg.cho_solve((self.factor, True), there)
        return DrawnField(
            waves=on_device(waves),
            phases=on_device(phases),
            heights=on_device(self.size * heights),
            places=on_device(self.places),
            pulls=on_device(self.size * pulls),
            length=on_device(self.length),
        )


def _matern_waves(
    dim: int, generator: np.random.Generator
) -> tuple[Float[np.ndarray, "wave dim"], Float[np.ndarray, " wave"]]:
    """Waves of a process of length one, and the variance of each, one in the mean.

    The spectrum of Matern's process of order 5/2 is Student's distribution of five
    degrees. What is left of the process between visited places is its shortest waves,
    of which that draws few: so they are drawn from wider distributions, too.
    """
    spread = np.sqrt(5 / generator.chisquare(5, WAVES)) * np.resize(WIDER, WAVES)
    waves = generator.normal(size=(WAVES, dim)) * spread[:, None]

    def density(factor: float) -> Float[np.ndarray, " wave"]:
        squares = np.sum((waves / factor) ** 2, axis=1)
        return factor**-dim * (1 + squares / 5) ** (-(5 + dim) / 2)

    return waves, density(1.0) / np.mean([density(one) for one in WIDER], axis=0)


@eqx.filter_jit
def _values_and_gradients(
    force: AbstractForce, places: Float[Array, "place dim"]
) -> tuple[Float[Array, "place component"], Float[Array, "place component dim"]]:
    def at(x: Float[Array, " dim"]) -> Any:
        if isinstance(force, AbstractProfileTerm) and x.shape == (1,):
            value = force.profile(x[0])[None]
        else:
            value = force(jnp.zeros(()), x, jnp.zeros_like(x))
        return value, value

    gradients, values = jax.vmap(jax.jacfwd(at, has_aux=True))(places)
    return values, gradients


def _extent(places: Places) -> float:
    """Diagonal of the box about places [L]; one where it is none."""
    return float(np.linalg.norm(np.ptp(places, axis=0))) or 1.0


def thin(places: Places, apart: float) -> Float[np.ndarray, "kept dim"]:
    """Places of which no more than a few are nearer to each other than `apart` [L]."""
    while True:
        cells = np.floor((places - places.min(axis=0)) / apart).astype(int)
        _, kept = np.unique(cells, axis=0, return_index=True)
        if len(kept) <= MOST_PLACES:
            return places[kept]
        apart *= 1.25


def _correlation(
    first: Float[np.ndarray, "one dim"],
    second: Float[np.ndarray, "other dim"],
    length: float,
) -> Float[np.ndarray, "one other"]:
    from scipy.spatial.distance import cdist

    a = np.sqrt(5.0) * cdist(first, second) / length
    return (1 + a + a * a / 3) * np.exp(-a)


class DrawnField(eqx.Module):
    """A draw of a `Ground`: a sum of waves and of kernels at the visited places."""

    waves: Float[Array, "wave coordinate"]
    phases: Float[Array, " wave"]
    heights: Float[Array, "wave component"]
    places: Float[Array, "place coordinate"]
    pulls: Float[Array, "place component"]
    length: Float[Array, ""]

    def __call__(self, x: Float[Array, " coordinate"]) -> Float[Array, " component"]:
        squares = jnp.sum((x[None] - self.places) ** 2, axis=1)
        a = jnp.sqrt(5.0 * squares / self.length**2 + 1e-12)  # smooth at a place
        alike = (1 + a + a * a / 3) * jnp.exp(-a)
        return jnp.cos(self.waves @ x + self.phases) @ self.heights - alike @ self.pulls


class AbstractDoubt(eqx.Module):
    """The doubt of a part of a force where nobody has been."""

    @abc.abstractmethod
    def variance(self, points: Places) -> Places:
        """Variance of each component of the force at points."""

    @abc.abstractmethod
    def draw(self, generator: np.random.Generator) -> AbstractForce:
        """A force, drawn, that is nothing where somebody has been."""


class FieldDoubt(AbstractDoubt):
    """The doubt of a part that is a field in space."""

    ground: Ground

    def variance(self, points: Places) -> Places:
        return np.repeat(self.ground.variance(points)[:, None], points.shape[1], axis=1)

    def draw(self, generator: np.random.Generator) -> AbstractForce:
        return DrawnForce(self.ground.draw(self.ground.places.shape[1], generator))


class ProfileDoubt(AbstractDoubt):
    """The doubt of a term with a profile, in its coordinate.

    Attributes:
        least: visited distance, where the profile is one of distances [L]; else minus
            infinity.
    """

    term: AbstractProfileTerm
    ground: Ground
    least: float

    def variance(self, points: Places) -> Places:
        least, places = on_device(self.least), on_device(points)
        arrays = _coordinates_and_bends(self.term, least, places)
        values, slopes, bends = map(np.asarray, arrays)
        unknown = self.ground.variance(values.reshape(-1, 1)).reshape(values.shape)
        if self.term.rotational:
            slopes = slopes[..., ::-1]
        return np.sum((unknown + bends**2)[..., None] * slopes**2, axis=1)

    def draw(self, generator: np.random.Generator) -> AbstractForce:
        field, bend = self.ground.draw(1, generator), generator.normal()
        return DrawnProfile(self.term, field, on_device(self.least), on_device(bend))


@eqx.filter_jit
def _coordinates_and_bends(
    term: AbstractProfileTerm,
    least: Float[Array, ""],
    places: Float[Array, "place dim"],
) -> tuple[Array, Array, Array]:
    """Coordinates of a term at places, their slopes, and how far it may bend there."""

    def one(x: Vector) -> tuple[Array, Array, Array]:
        values, slopes = term.coordinates(x), jax.jacfwd(term.coordinates)(x)
        return values, slopes, jax.vmap(lambda z: _bend(term, least, z))(values)

    return jax.vmap(one)(places)


def _bend(term: AbstractProfileTerm, least: Scalar, z: Scalar) -> Float[Array, ""]:
    """A profile that goes on as at its least visited distance, less itself, within."""
    start = jnp.where(jnp.isfinite(least), least, 0.0)
    value, slope = jax.jvp(term.profile, (start,), (jnp.ones_like(start),))
    return jnp.where(z < least, value + slope * (z - start) - term.profile(z), 0.0)


class DrawnForce(AbstractForce):
    """A drawn force on unvisited ground."""

    field: DrawnField

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.field(x)


class DrawnProfile(AbstractForce):
    """A drawn profile of a term, where no coordinate of the data has been.

    Attributes:
        least: see `ProfileDoubt`.
        bend: share of the way on which the profile goes on as at `least`.
    """

    term: AbstractProfileTerm
    field: DrawnField
    least: Float[Array, ""]
    bend: Float[Array, ""]

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        def profile(z: Scalar) -> Float[Array, ""]:
            return self.field(jnp.reshape(z, 1))[0] + self.bend * _bend(
                self.term, self.least, z
            )

        z, pull = jax.vjp(self.term.coordinates, x)
        (force,) = pull(jax.vmap(profile)(z))
        return quarter_turn(force) if self.term.rotational else force


def doubts(
    force: AbstractLearnedForce,
    visited: Places,
    variance: Callable[[Callable[[Any], AbstractForce], Places], Places],
) -> Iterator[AbstractDoubt]:
    """The doubt of each part of a force whose form elsewhere nothing tells.

    A linear force and a lattice are the same everywhere.

    Args:
        variance: of a part of the force at places, by the posterior.
    """
    if not len(visited):
        return
    for index, period in force.periods.items():
        shift = period * np.eye(visited.shape[1])[index]
        visited = np.concatenate([visited, visited - shift, visited + shift])
    places = thin(visited, _extent(visited) / np.sqrt(MOST_PLACES))
    terms, rest = split_structure(force)
    part = attrgetter("remainder") if terms else _whole
    yield FieldDoubt(Ground.of(rest, visited, variance(part, places)))
    for term in terms:
        if isinstance(term, HillsTerm):
            yield FieldDoubt(Ground.of(term, visited))
        if isinstance(term, AbstractProfileTerm):
            least = on_device(-np.inf)
            arrays = _coordinates_and_bends(term, least, on_device(visited))
            values = np.asarray(arrays[0]).reshape(-1, 1)
            nearest = float(values.min()) if term.is_odd else -np.inf
            yield ProfileDoubt(term, Ground.of(term, values), nearest)


def _whole(force: AbstractForce) -> AbstractForce:
    return force
