"""Kinds of terms: where each may be, what lies next to it, and what is simpler."""

import itertools
from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.fitting.policy import POLICY
from pinav.fitting.structure.starts import (
    Region,
    central_term,
    circular,
    linear_term,
    wall_term,
)
from pinav.fitting.structure.trials import Terms
from pinav.forces import (
    AbstractTerm,
    CentralTerm,
    EllipticTerm,
    LatticeTerm,
    LinearTerm,
    ObstaclesTerm,
    WallTerm,
)
from pinav.forces.terms import HARMONICS

Places = Float[np.ndarray, "place dim"]


def simple_kinds(
    region: Region, places: Places, *, rotational: bool
) -> Iterator[list[AbstractTerm]]:
    """Linear forces, centres and walls, each kind at all its places.

    Args:
        places: of centres [L].
        rotational: include those that turn, in a plane.
    """
    for turn in (False, True) if rotational and region.is_planar else (False,):
        yield [linear_term(region, rotational=turn)]
        yield [central_term(region, place, rotational=turn) for place in places]
        if region.is_planar:
            angles = np.pi * np.arange(POLICY.angles) / POLICY.angles
            yield [wall_term(region, angle, rotational=turn) for angle in angles]


def turned_shears(size: float) -> Float[np.ndarray, "shear 2"]:
    """Shears of a size of the ellipses that are scanned, in all directions."""
    angles = 2 * np.pi * np.arange(POLICY.turns) / POLICY.turns
    return size * np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def lattices(region: Region) -> list[LatticeTerm]:
    """Square lattices of all periods and directions that the data could show."""
    finest = 2 * np.pi * POLICY.periods / region.core_extent
    # a step changes the phase at the rim of the data by a radian
    step = 2.0 / region.core_extent
    made = []
    for size in np.arange(2 * np.pi / region.core_extent, finest, step):
        turns = max(int(np.ceil(0.5 * np.pi * size / step)), 2)
        for angle in 0.5 * np.pi * np.arange(turns) / turns:
            one = size * np.array([np.cos(angle), np.sin(angle)])
            vectors = np.stack([one, [-one[1], one[0]]])
            made.append(_lattice(vectors, jnp.asarray(region.middle)))
    return made


def _lattice(
    vectors: Float[np.ndarray, "2 2"],
    origin: Float[Array, "2"],
    *,
    rotational: bool = False,
) -> LatticeTerm:
    return LatticeTerm(
        weights=jnp.zeros(2 * len(HARMONICS)),
        wave_vectors=jnp.asarray(vectors),
        origin=origin,
        rotational=rotational,
    )


def lattice_of(first: WallTerm, second: WallTerm) -> LatticeTerm:
    """The lattice of the dominant waves in the profiles of two walls.

    Two plane waves are two walls, which explain the data as well where these are, but
    not what repeats beyond them.
    """
    vectors = np.stack([_wave_vector(first), _wave_vector(second)])
    return _lattice(vectors, first.origin, rotational=first.rotational)


def _wave_vector(wall: WallTerm) -> Float[np.ndarray, "2"]:
    z = np.asarray(wall.places)
    profile = np.asarray(jax.vmap(wall.profile)(wall.places))
    waving = profile - np.polyval(np.polyfit(z, profile, 1), z)
    shortest = POLICY.shortest * float(wall.width)
    sizes = np.linspace(2 * np.pi / np.ptp(z), 2 * np.pi / shortest, WAVES)
    power = np.abs(np.exp(1j * np.outer(sizes, z)) @ waving)
    size, angle = sizes[np.argmax(power)], float(wall.angle)
    return size * np.array([np.cos(angle), np.sin(angle)])


WAVES = 1000
"""Waves that are compared with a profile."""


def simpler(terms: Terms, region: Region) -> Iterator[Terms]:
    """Structures with one term, one centre or one direction less.

    An ellipse without end is a wall, one as wide as long is central; a lattice with
    waves in one direction is a wall. Two plane waves are two walls, too, where data
    explain no more than those.
    """
    walls = [term for term in terms if isinstance(term, WallTerm)]
    for one, two in itertools.combinations(walls, 2):
        if one.rotational == two.rotational:
            rest = (term for term in terms if term is not one and term is not two)
            yield (*rest, lattice_of(one, two))
    for index, term in enumerate(terms):
        before, after = terms[:index], terms[index + 1 :]
        if len(terms) > 1:
            yield before + after
        if isinstance(term, EllipticTerm):
            yield (*before, _endless(term, region), *after)
            yield (*before, circular(term, term.center), *after)
        if isinstance(term, LatticeTerm):
            for x, y in np.asarray(term.wave_vectors):
                angle = float(np.arctan2(y, x))
                wall = wall_term(region, angle, rotational=term.rotational)
                yield (*before, wall, *after)
        if isinstance(term, ObstaclesTerm):
            yield from ((*before, fewer, *after) for fewer in with_one_less(term))


def _endless(term: EllipticTerm, region: Region) -> WallTerm:
    """The wall along the long axis of an ellipse."""
    angle = 0.5 * float(np.arctan2(term.shear[1], term.shear[0]))
    return wall_term(region, angle, rotational=term.rotational)


def with_one_less(term: ObstaclesTerm) -> Iterator[ObstaclesTerm | CentralTerm]:
    """The obstacles without each of them in turn; the last of all is a central term."""
    for index in range(len(term.centers)):
        centers = jnp.delete(term.centers, index, axis=0)
        if len(centers) > 1:
            yield eqx.tree_at(lambda one: one.centers, term, centers)
        else:
            yield circular(term, centers[0])


def signature(terms: Terms) -> tuple[str, ...]:
    """Kinds of terms, sorted: what counts as the same hypothesis."""
    return tuple(sorted(term.kind for term in terms))


def has_shape(term: AbstractTerm) -> bool:
    """True for all but a linear force with a potential, which stands beside others."""
    return not isinstance(term, LinearTerm) or term.rotational
