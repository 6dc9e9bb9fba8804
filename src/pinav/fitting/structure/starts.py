"""Terms with a structure at the places where a search for one begins.

Their kernels and their scanned places come from where the data are.
"""

import functools
from collections.abc import Callable, Sequence
from typing import TypeVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import on_device
from pinav.fitting.policy import POLICY
from pinav.forces import (
    AbstractProfileTerm,
    CentralTerm,
    EllipticTerm,
    LinearTerm,
    ObstaclesTerm,
    WallTerm,
)

FINER, FINEST = 1.5, 3
"""The factor by which there are more across the extent where that is larger, once or a
few times."""

BEYOND = 4.0
"""Reach of a profile beyond the data, in widths of its kernels."""

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
        shares = np.linspace(0.05, 0.95, POLICY.ranks[positions.shape[1] == 3])
        return cls(
            middle=(low + high) / 2,
            extent=float((high - low).max()),
            core_extent=float((most - few).max()),
            core_center=(few + most) / 2,
            quartile_extent=2 * float((upper - lower).max()),
            ranks=np.quantile(positions, shares, axis=0),
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
        return float(self.extent / round(POLICY.kernels[not self.is_planar] * finer))

    def grid(self, side: int) -> Float[np.ndarray, "point dim"]:
        """Places that are scanned, evenly over most of the data."""
        axis = np.linspace(-0.5, 0.5, side) * self.core_extent
        return self.core_center + _mesh([axis] * len(self.middle))

    def places(self) -> Float[np.ndarray, "point dim"]:
        """Centres that are scanned first: even, and dense where the data are."""
        # swimmers that are flung out make the even grid coarse
        return np.concatenate(
            [self.grid(POLICY.grid[not self.is_planar]), self.dense_places()]
        )

    def dense_places(self, side: int | None = None) -> Float[np.ndarray, "point dim"]:
        """Places that are dense where the data are, as many along each axis."""
        side = len(self.ranks) if side is None else side
        chosen = np.linspace(0, len(self.ranks) - 1, side).round().astype(int)
        return _mesh(self.ranks[chosen].T)

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
