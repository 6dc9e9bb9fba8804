"""Terms with a structure at the places where a search for one begins.

Their kernels and their scanned places come from where the data are.
"""

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from pinav.arguments import on_device
from pinav.forces import (
    AbstractProfileTerm,
    AbstractTerm,
    CentralTerm,
    EllipticTerm,
    LinearTerm,
    ObstaclesTerm,
    WallTerm,
)

KERNELS = {2: 36, 3: 18}
"""Kernels of a profile across the ground that most of the data are on, by the dimension
of space, in which many more places are scanned."""

FINER, FINEST = 1.5, 3
"""The factor by which there are more across the extent where that is larger, once or a
few times."""

BEYOND = 4.0
"""Reach of a profile beyond the data, in widths of its kernels."""

GRID = {2: 7, 3: 5}
"""Places along each side of the data that are scanned, by the dimension of space."""

RANKS = {2: 7, 3: 3}
"""Shares of the data along each axis at which further places are scanned."""

ANGLES = 18
"""Directions that are scanned."""


Term = TypeVar("Term", bound=AbstractProfileTerm)


class Region(eqx.Module):
    """The region with data.

    Attributes:
        middle: of the data [L].
        extent: longest side of the box around them [L].
        core_extent: longest side of the box around nine tenths of them [L].
        core_center: the middle of that box [L].
        quartile_extent: twice the longest distance between the quartiles [L]: of evenly
            spread data their extent, of swimmers that are flung out less.
        ranks: positions along each axis with equal shares of the data between them [L].
    """

    middle: Float[np.ndarray, " dim"]
    extent: float
    core_extent: float
    core_center: Float[np.ndarray, " dim"]
    quartile_extent: float
    ranks: Float[np.ndarray, "rank dim"]

    @classmethod
    def of(cls, positions: Float[np.ndarray, "sample dim"]) -> "Region":
        """The region of observed positions."""
        low, high = positions.min(axis=0), positions.max(axis=0)
        few, most = np.quantile(positions, [0.05, 0.95], axis=0)
        lower, upper = np.quantile(positions, [0.25, 0.75], axis=0)
        return cls(
            middle=(low + high) / 2,
            extent=float((high - low).max()),
            core_extent=float((most - few).max()),
            core_center=(few + most) / 2,
            quartile_extent=2 * float((upper - lower).max()),
            ranks=np.quantile(
                positions, np.linspace(0.05, 0.95, RANKS[positions.shape[1]]), axis=0
            ),
        )

    @property
    def is_planar(self) -> bool:
        """True if the data lie in a plane, which alone has walls and swirls here."""
        return len(self.middle) == 2

    @property
    def width(self) -> float:
        """Width of a kernel of a profile [L]."""
        # few widths, so that regions share compilations
        wanted = np.log(self.extent / max(self.quartile_extent, 1e-9)) / np.log(FINER)
        finer = FINER ** np.clip(np.floor(wanted + 0.3), 0, FINEST - 1)
        return float(self.extent / round(KERNELS[len(self.middle)] * finer))

    def grid(
        self,
        side: int,
        middle: Float[np.ndarray, " dim"] | None = None,
        fraction: float = 1.0,
    ) -> Float[np.ndarray, "point dim"]:
        """Places that are scanned.

        Args:
            middle: of the grid [L]; that of most of the data unless given.
            fraction: its size, as a share of the extent of most of the data.
        """
        middle = self.core_center if middle is None else middle
        axis = np.linspace(-0.5, 0.5, side) * self.core_extent * fraction
        return middle + _mesh([axis] * len(middle))

    def places(self) -> Float[np.ndarray, "point dim"]:
        """Centres that are scanned first: even, and dense where the data are."""
        # swimmers that are flung out make the even grid coarse
        return np.concatenate([self.grid(GRID[len(self.middle)]), _mesh(self.ranks.T)])

    def distances(self) -> tuple[Float[Array, " kernel"], Float[Array, ""]]:
        """Places of the kernels of a profile of a distance, and their width."""
        # as far as from one corner to the other: the same for every centre, so that
        # all of them share one compilation
        reach = 0.75 * np.sqrt(len(self.middle)) * self.extent
        places = np.arange(0.5, reach / self.width + BEYOND) * self.width
        return on_device(places), on_device(self.width)

    def offsets(self) -> tuple[Float[Array, " kernel"], Float[Array, ""]]:
        """Places of the kernels of a profile along a direction, and their width."""
        half = 0.55 * np.sqrt(len(self.middle)) * self.extent / self.width + BEYOND
        places = np.arange(-half, half + 1.0) * self.width
        return on_device(places), on_device(self.width)


def _mesh(
    axes: Sequence[Float[np.ndarray, " place"]] | Float[np.ndarray, "dim place"],
) -> Float[np.ndarray, "point dim"]:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def scanned_terms(
    region: Region, summits: Float[np.ndarray, "place dim"], *, rotational: bool
) -> Iterator[list[AbstractTerm]]:
    """Terms of each kind, with the geometries that are scanned.

    Args:
        summits: further places of centres [L]; there may be none.
    """
    centers = np.concatenate([region.places(), summits])
    for turn in (False, True) if rotational and region.is_planar else (False,):
        yield [linear_term(region, rotational=turn)]
        yield [central_term(region, place, rotational=turn) for place in centers]
        if region.is_planar:
            angles = np.pi * np.arange(ANGLES) / ANGLES
            yield [wall_term(region, angle, rotational=turn) for angle in angles]


def central_term(
    region: Region, center: Float[np.ndarray, " dim"], *, rotational: bool = False
) -> CentralTerm:
    """A central term about a place, without weight yet."""
    make = _on_kernels(CentralTerm, *region.distances())
    return make(center=on_device(center), rotational=rotational)


def wall_term(region: Region, angle: float, *, rotational: bool = False) -> WallTerm:
    """A wall whose normal has this angle, without weight yet."""
    make = _on_kernels(WallTerm, *region.offsets())
    origin = on_device(region.middle)
    return make(angle=on_device(angle), origin=origin, rotational=rotational)


def _on_kernels(
    kind: Callable[..., Term], places: Float[Array, " kernel"], width: Float[Array, ""]
) -> Callable[..., Term]:
    weights = on_device(np.zeros(places.shape))
    return functools.partial(kind, weights=weights, places=places, width=width)


def linear_term(region: Region, *, rotational: bool = False) -> LinearTerm:
    """A linear force, zero as yet."""
    dim = len(region.middle)
    count = 1 if rotational else dim + dim * (dim + 1) // 2
    return LinearTerm(
        weights=on_device(np.zeros(count)),
        origin=on_device(region.middle),
        scale=on_device(region.extent / 2),
        rotational=rotational,
    )


def circular(
    term: EllipticTerm | ObstaclesTerm, center: Float[Array, "2"]
) -> CentralTerm:
    """The central term about a place with the profile of an ellipse or of obstacles."""
    return _with_profile(CentralTerm, term)(center=center)


def obstacles_at(
    term: CentralTerm | ObstaclesTerm, centers: Float[Array, "center dim"]
) -> ObstaclesTerm:
    """Obstacles at several centres with the profile of a term."""
    return _with_profile(ObstaclesTerm, term)(centers=centers)


def _with_profile(
    kind: Callable[..., Term], term: AbstractProfileTerm
) -> Callable[..., Term]:
    return functools.partial(
        kind,
        weights=term.weights,
        places=term.places,
        width=term.width,
        rotational=term.rotational,
        law=term.law,
    )


def ellipses(
    region: Region,
    centers: Float[np.ndarray, "place 2"],
    shears: Float[np.ndarray, "shear 2"],
) -> list[EllipticTerm]:
    """Elliptic terms about several centres [L], each of several axes."""
    make = _on_kernels(EllipticTerm, *region.distances())
    return [
        make(center=on_device(center), shear=on_device(shear))
        for center in centers
        for shear in shears
    ]


def turned_shears() -> Float[np.ndarray, "shear 2"]:
    """Shears of ellipses in several directions."""
    return SHEAR * _directions(2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS)


def segments(region: Region, wall: WallTerm) -> list[EllipticTerm]:
    """Long ellipses along the layers of a wall, over most of the data.

    A wall that is fitted to a segment has its direction. Its crests need not be where
    the segment is: what is beyond the ends moves them.

    Args:
        wall: one that was fitted to them; one without a potential has no crests.
    """
    if wall.rotational:
        return []
    angle = np.asarray(wall.angle)
    normal, along = _directions(angle), _directions(angle + 0.5 * np.pi)
    across = np.linspace(-0.5, 0.5, ACROSS) * region.core_extent
    steps = np.linspace(-0.5, 0.5, ALONG) * region.core_extent
    rows = across[:, None, None] * normal + steps[:, None] * along
    shears = LONG * _directions(2 * angle)[None]
    return ellipses(region, region.core_center + rows.reshape(-1, 2), shears)


def _directions(angles: Float[ArrayLike, "*all"]) -> Float[np.ndarray, "*all 2"]:
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


SHEAR, DIRECTIONS = 0.4, 8
"""Size of $S$ of the ellipses that are tried, axes in the ratio of 2.2; and how many
directions."""

LONG = 0.9
"""Size of $S$ of long ellipses, axes in the ratio of 6."""

ACROSS, ALONG = 51, 9
"""Places of long ellipses across a wall, where they must be right to their width, and
along it."""
