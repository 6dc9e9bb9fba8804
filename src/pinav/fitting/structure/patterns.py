r"""Terms where a search begins: lattices, obstacles of one kind, pairs.

A lattice is sought by the period and direction of a square one; the places of obstacles
are the peaks of the potential that free kernels have in the linearised data.

A search that adds one term at a time may begin with a term that is in no sum of few: an
ellipse stands for a hill and a wall, and nothing that is added to it leads back. So all
pairs of scanned terms are compared: at a fixed smoothness a profile has few directions,
and the products of all of them with each other are one matrix.
"""

import itertools
from collections.abc import Iterator, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.ndimage import maximum_filter

from pinav.arguments import on_device
from pinav.errors import FitError
from pinav.fitting.environments.kernels import KernelGrid, surround_with_kernels
from pinav.fitting.evidence.evidence import (
    LinearisedObservations,
    Whitened,
    at_shape,
    posterior_mean,
    root,
)
from pinav.fitting.structure.response import (
    ForceResponse,
    force_quadratic,
    term_columns,
)
from pinav.fitting.structure.starts import (
    Region,
    central_term,
    circular,
    obstacles_at,
)
from pinav.forces import (
    AbstractTerm,
    CentralTerm,
    KernelPotential,
    LatticeTerm,
    ObstaclesTerm,
    WallTerm,
)
from pinav.forces.priors import Shape
from pinav.forces.terms import HARMONICS

MOST_PERIODS = 6
"""Periods of a lattice across most of the data, at most."""

WAVE, WAVES = 4, 1000
"""Length of the shortest wave of a profile that is sought, in widths of its kernels,
and how many are tried."""

MAP, MAP_POINTS = KernelGrid(across=16, margin=2.0), 61
"""Kernels of the map whose peaks are sought, and points along each side of it."""

PEAK, MOST_PEAKS, APART = 0.6, 8, 15
"""Height of a peak that counts, relative to the highest; how many there may be; and
points of the map within which a peak is the only one."""


def lattices(region: Region) -> list[LatticeTerm]:
    """Square lattices of all periods and directions that the data could show."""
    finest = 2 * np.pi * MOST_PERIODS / region.core_extent
    # a step changes the phase at the rim of the data by a radian
    step = 2.0 / region.core_extent
    made = []
    for size in np.arange(2 * np.pi / region.core_extent, finest, step):
        turns = max(int(np.ceil(0.5 * np.pi * size / step)), 2)
        for angle in 0.5 * np.pi * np.arange(turns) / turns:
            one = size * np.array([np.cos(angle), np.sin(angle)])
            vectors = jnp.asarray([one, [-one[1], one[0]]])
            weights = jnp.zeros(2 * len(HARMONICS))
            origin = jnp.asarray(region.middle)
            lattice = LatticeTerm(weights=weights, wave_vectors=vectors, origin=origin)
            made.append(lattice)
    return made


def lattice_of(first: WallTerm, second: WallTerm) -> LatticeTerm:
    """The lattice of the dominant waves in the profiles of two walls.

    Two plane waves are two walls, which explain the data as well where these are, but
    not what repeats beyond them.
    """
    return LatticeTerm(
        weights=jnp.zeros(2 * len(HARMONICS)),
        wave_vectors=jnp.asarray([_wave_vector(first), _wave_vector(second)]),
        origin=first.origin,
        rotational=first.rotational,
    )


def _wave_vector(wall: WallTerm) -> Float[np.ndarray, "2"]:
    z = np.asarray(wall.places)
    profile = np.asarray(jax.vmap(wall.profile)(wall.places))
    waving = profile - np.polyval(np.polyfit(z, profile, 1), z)
    longest, shortest = np.ptp(z), WAVE * float(wall.width)
    sizes = np.linspace(2 * np.pi / longest, 2 * np.pi / shortest, WAVES)
    power = np.abs(np.exp(1j * np.outer(sizes, z)) @ waving)
    size, angle = sizes[np.argmax(power)], float(wall.angle)
    return size * np.array([np.cos(angle), np.sin(angle)])


class PotentialMap(eqx.Module):
    """The potential [L² T⁻²] that free kernels have in the linearised data."""

    places: Float[np.ndarray, "row column 2"]
    heights: Float[np.ndarray, "row column"]
    is_seen: Bool[np.ndarray, "row column"]

    @classmethod
    def of(cls, response: ForceResponse) -> "PotentialMap | None":
        """The map of the data; None where they do not depend on it."""
        positions = np.asarray(response.points).reshape(-1, 2)
        potential = free_potential(response, positions)
        return None if potential is None else cls.of_potential(potential, positions)

    @classmethod
    def of_potential(
        cls,
        potential: KernelPotential,
        positions: Float[np.ndarray, "point 2"],
        points: int = MAP_POINTS,
        reach: float = 1.0,
    ) -> "PotentialMap":
        """The map of a potential.

        Args:
            reach: distance from the data, in widths of the kernels, up to which the
                potential counts as seen.
        """
        from scipy.spatial import KDTree

        axes = np.linspace(positions.min(axis=0), positions.max(axis=0), points).T
        places = np.stack(np.meshgrid(*axes), axis=-1)
        heights = np.asarray(_heights(potential, on_device(places.reshape(-1, 2))))
        gaps = KDTree(positions).query(places)[0]
        return cls(
            places=places,
            heights=heights.reshape(places.shape[:2]),
            is_seen=gaps < reach * float(potential.width),
        )

    def peaks(
        self, heights: Float[np.ndarray, "row column"], apart: int, least: float
    ) -> Float[np.ndarray, "peak 2"]:
        """Places of peaks of heights over the map, the highest first [L]."""
        seen = np.where(self.is_seen, heights, 0.0)
        is_peak = (seen == maximum_filter(seen, size=apart)) & (
            seen > least * seen.max()
        )
        order = np.argsort(-seen[is_peak])
        return self.places[is_peak][order]

    def summits(self) -> Float[np.ndarray, "place 2"]:
        """Places where the potential differs most from that of a linear force [L]."""
        x, y = np.moveaxis(self.places, -1, 0)
        columns = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
        seen = columns[self.is_seen], self.heights[self.is_seen]
        rest = self.heights - columns @ np.linalg.lstsq(*seen, rcond=None)[0]
        return self.peaks(np.abs(rest), NEARBY, SUMMIT)[:MOST_PEAKS]


@eqx.filter_jit
def _heights(
    potential: KernelPotential, places: Float[Array, "place 2"]
) -> Float[Array, " place"]:
    return jax.vmap(lambda x: potential.potential(0.0, x))(places)


NEARBY, SUMMIT = 9, 0.3
"""Points of the map within which a summit is the only one, and its height at least,
relative to the highest."""


def obstacles(seen: PotentialMap, region: Region) -> Iterator[ObstaclesTerm]:
    """Several hills or several wells at the peaks of the free potential, if any."""
    middle = np.median(seen.heights[seen.is_seen])
    start = central_term(region, region.middle)
    for sign in (1.0, -1.0):
        centers = seen.peaks(sign * (seen.heights - middle), APART, PEAK)
        if 2 <= len(centers) <= MOST_PEAKS:
            yield obstacles_at(start, jnp.asarray(centers))


def twins(
    term: CentralTerm | ObstaclesTerm, places: Float[np.ndarray, "place dim"]
) -> list[ObstaclesTerm]:
    """Obstacles of the kind of a central term, one more than there are."""
    several = isinstance(term, ObstaclesTerm)
    centers = term.centers if several else term.center[None]
    return [
        obstacles_at(term, jnp.concatenate([centers, jnp.asarray(place)[None]]))
        for place in places
    ]


def with_one_less(term: ObstaclesTerm) -> Iterator[ObstaclesTerm | CentralTerm]:
    """The obstacles without each of them in turn; the last of all is a central term."""
    for index in range(len(term.centers)):
        centers = jnp.delete(term.centers, index, axis=0)
        if len(centers) > 1:
            yield eqx.tree_at(lambda one: one.centers, term, centers)
        else:
            yield circular(term, centers[0])


def free_potential(
    response: ForceResponse, positions: Float[np.ndarray, "point 2"]
) -> KernelPotential | None:
    """Free kernels of the linearised data; None if the data do not depend on them."""
    kernels = KernelPotential.with_zero_weights(*surround_with_kernels(positions, MAP))
    prior = kernels.prior()
    shape = prior.start.copy()
    shape[1] = prior.bounds[1, 1]
    try:
        data = LinearisedObservations.of(force_quadratic([kernels], response))
    except FitError:
        return None
    chosen = at_shape(data, prior.covariance, shape)
    mean = posterior_mean(Whitened.of(data, prior.covariance(shape)), chosen)
    return KernelPotential(on_device(mean), kernels.centers, kernels.width)


DIRECTIONS = 24
"""Directions of a profile that count, at most."""

RATIOS = (1e-4, 1e-6, 1e-8)
"""Variances of the noise that are tried, relative to the largest of the force."""

ROUNDING = 1e-12
"""Share of the squares that are rounding."""

AT_ONCE = 2000
"""Pairs whose evidence is computed in one call."""


class ScannedPair(eqx.Module):
    """The best pair of two kinds."""

    terms: tuple[AbstractTerm, AbstractTerm]
    log_evidence: float


def scan_pairs(
    kinds: Sequence[Sequence[AbstractTerm]],
    shapes: Sequence[Shape],
    beside: AbstractTerm,
    response: ForceResponse,
) -> list[ScannedPair]:
    """The best pair of each two kinds, that of highest evidence first."""
    blocks = [
        _directions([beside], beside.prior().start, response),
        *(
            _directions(terms, s, response)
            for terms, s in zip(kinds, shapes, strict=True)
        ),
    ]
    products = _Products.of(blocks, response)
    made = []
    for first, second in itertools.combinations_with_replacement(range(len(kinds)), 2):
        values = products.evidences(first, second)
        if second == first:  # each pair once, and no term beside itself
            values[np.tri(len(values), dtype=bool)] = -np.inf
        best = int(np.argmax(values))
        i, j = divmod(best, values.shape[1])
        pair = kinds[first][i], kinds[second][j]
        made.append(ScannedPair(pair, float(values.flat[best])))
    return sorted(made, key=lambda one: -one.log_evidence)


def _directions(
    terms: Sequence[AbstractTerm], shape: Shape, response: ForceResponse
) -> Float[np.ndarray, "term datum direction"]:
    """Residuals by the directions of most variance of the weights of each term."""
    chosen = root(terms[0].prior().covariance(shape))[:, :DIRECTIONS]
    return np.stack([rows @ chosen for rows in term_columns(terms, response)])


class _Products(eqx.Module):
    """Products of all directions of all terms with each other."""

    gram: Float[np.ndarray, "all all"]
    along: Float[np.ndarray, " all"]
    places: list[Int[np.ndarray, "_ _"]]
    squares: float
    num_free: int

    @classmethod
    def of(
        cls,
        blocks: Sequence[Float[np.ndarray, "_ datum _"]],
        response: ForceResponse,
    ) -> "_Products":
        stacked = np.concatenate([side for block in blocks for side in block], axis=1)
        sizes = [block.shape[0] * block.shape[2] for block in blocks]
        places = np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1])
        offset = response.residuals_of_none
        return cls(
            gram=stacked.T @ stacked,
            along=stacked.T @ offset,
            places=[p.reshape(len(b), -1) for p, b in zip(places, blocks, strict=True)],
            squares=float(offset @ offset) + response.squares,
            num_free=response.num_free,
        )

    def evidences(self, one: int, other: int) -> Float[np.ndarray, "one other"]:
        (fixed,), *kinds = self.places
        first, second = kinds[one], kinds[other]
        pairs = np.argwhere(np.ones((len(first), len(second)), bool))
        held = np.broadcast_to(fixed, (len(pairs), len(fixed)))
        sides = held, first[pairs[:, 0]], second[pairs[:, 1]]
        places = np.concatenate(sides, axis=1)
        parts = [
            self._evidences(places[begin : begin + AT_ONCE])
            for begin in range(0, len(places), AT_ONCE)
        ]
        return np.concatenate(parts).reshape(len(first), len(second))

    def _evidences(
        self, places: Int[np.ndarray, "pair direction"]
    ) -> Float[np.ndarray, " pair"]:
        """Log evidence of weights at several places, at the best of a few ratios."""
        matrices = self.gram[places[:, :, None], places[:, None, :]]
        vectors, count = self.along[places], places.shape[1]
        largest = np.trace(matrices, axis1=1, axis2=2)
        best = np.full(len(places), -np.inf)
        for share in RATIOS:
            ratio = share * largest
            lower = np.linalg.cholesky(matrices + ratio[:, None, None] * np.eye(count))
            whitened = np.linalg.solve(lower, vectors[..., None])[..., 0]
            left = self.squares - (whitened**2).sum(axis=1)
            left = np.maximum(left, ROUNDING * self.squares)
            sizes = np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
            values = -0.5 * (self.num_free * np.log(left) - count * np.log(ratio))
            best = np.maximum(best, values - sizes)
        return best
