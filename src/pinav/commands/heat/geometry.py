"""Where things are in a case of `pinav heat`: grid, tumour, walls and probes."""

import math
from typing import Annotated, Literal

from msgspec import Meta

from pinav.commands.heat.bounds import Cells, Celsius, Edge, Length, Place, Strict, Time


class _Round(Strict, frozen=True):
    """A grid over the radius [m]."""

    radius: Length
    cells: Cells

    @property
    def lengths(self) -> tuple[float, ...]:
        """Extent along each axis [m]."""
        return (self.radius,)

    @property
    def sizes(self) -> tuple[float, ...]:
        """Edges of a cell [m]."""
        return (self.radius / self.cells,)

    @property
    def count(self) -> int:
        """Number of cells."""
        return self.cells


class Sphere(_Round, frozen=True, tag="sphere", tag_field="kind"):
    """A sphere, everything a function of the radius [m]."""


class Cylinder(_Round, frozen=True, tag="cylinder", tag_field="kind"):
    """A long cylinder, everything a function of the radius [m]."""


class Box(Strict, frozen=True, tag="box", tag_field="kind"):
    """Two or three axes with cells of a size [m], the same along all unless given."""

    cells: tuple[Cells, ...]
    size: Length | tuple[Length, ...]

    def __post_init__(self) -> None:
        if len(self.cells) not in (2, 3):
            raise ValueError(
                f"cells: expected two or three numbers, got {len(self.cells)}; take a "
                "sphere or a cylinder for one axis"
            )
        if len(self.sizes) != len(self.cells):
            raise ValueError(
                f"size: expected one number, or {len(self.cells)}, one for each axis, "
                f"got {len(self.sizes)}"
            )

    @property
    def sizes(self) -> tuple[float, ...]:
        """Edges of a cell [m]."""
        if isinstance(self.size, tuple):
            return self.size
        return (self.size,) * len(self.cells)

    @property
    def lengths(self) -> tuple[float, ...]:
        """Extent along each axis [m]."""
        return tuple(n * h for n, h in zip(self.cells, self.sizes, strict=True))

    @property
    def count(self) -> int:
        """Number of cells."""
        return math.prod(self.cells)


class Voxels(Strict, frozen=True, tag="voxels", tag_field="kind"):
    """The voxels of an image whose values are labels of tissues.

    The size [m] along each axis is that of the file, if it has one.
    """

    labels: str
    size: tuple[Edge, ...] | None = None


Meshed = Sphere | Cylinder | Box
"""A grid whose cells are known without a file."""

Grid = Meshed | Voxels


class Wall(Strict, frozen=True):
    """The outer sides: a temperature [°C], or an exchange [W/m²/K] with an ambient.

    Unless one of them is given, the wall is at 37 °C.
    """

    temperature: Celsius | None = None
    exchange: Annotated[float, Meta(gt=0, le=1e6)] | None = None
    ambient: Celsius | None = None

    def __post_init__(self) -> None:
        if (self.exchange is None) != (self.ambient is None):
            raise ValueError(
                "expected an ambient temperature with an exchange, and an exchange "
                "with an ambient temperature"
            )
        if self.temperature is not None and self.exchange is not None:
            raise ValueError(
                "expected a temperature or an exchange, got both; remove one"
            )


Side = Wall | Literal["insulated"]
"""What is at one side; insulated stands for a plane of symmetry, too."""


class Ends(Strict, frozen=True):
    """Both sides across one axis of a box; the wall of the case unless given."""

    low: Side | None = None
    high: Side | None = None


Across = Ends | Literal["periodic"] | None
"""Both sides across an axis, or ends that meet."""


class Sides(Strict, frozen=True):
    """The sides across each axis of a box."""

    x: Across = None
    y: Across = None
    z: Across = None

    @property
    def along(self) -> tuple[Across, Across, Across]:
        """Those of each axis."""
        return self.x, self.y, self.z


class Probes(Strict, frozen=True):
    """Where [m] and how often [s] temperature is read."""

    points: tuple[tuple[Place, ...], ...]
    every: Time = 10.0

    def __post_init__(self) -> None:
        if len(set(self.points)) < len(self.points):
            raise ValueError("points: expected different places, got one twice")


def check_point(
    name: str, point: tuple[float, ...], lengths: tuple[float, ...]
) -> None:
    """Refuse a point that is not inside a grid of these lengths [m]."""
    if len(point) != len(lengths):
        raise ValueError(
            f"{name}: expected {len(lengths)} coordinates, one for each axis of "
            f"the grid, got {list(point)}"
        )
    for value, length in zip(point, lengths, strict=True):
        if not 0 <= value <= length:
            raise ValueError(
                f"{name}: expected between 0 and {length:g} m, the extent of the "
                f"grid, got {value:g} m"
            )


def check_sides(grid: Meshed, sides: Sides) -> None:
    """Refuse sides that a grid does not have."""
    count = len(grid.lengths) if isinstance(grid, Box) else 0
    for name, ends in tuple(zip("xyz", sides.along, strict=True))[count:]:
        if ends is not None:
            raise ValueError(
                f"sides.{name}: expected no sides but of the axes of a box, of which "
                f"this grid has {count}; use wall on a sphere or cylinder"
            )


def check_ball(
    grid: Meshed, radius: float, center: tuple[float, ...] | None, sides: Sides
) -> None:
    """Refuse a tumour that is not within the grid, or smaller than a cell.

    An insulated side is a plane of symmetry, through which a tumour may reach.
    """
    if isinstance(grid, Box):
        middle = center or tuple(0.5 * length for length in grid.lengths)
        check_point("tumour.center", middle, grid.lengths)
        largest = _free_radius(grid, middle, sides)
    elif center is not None:
        raise ValueError(
            "tumour.center: expected none on a sphere or cylinder, whose tumour is at "
            "its centre; take a box for another place"
        )
    else:
        largest = grid.radius
    if radius < 0.5 * (size := max(grid.sizes)):
        raise ValueError(
            f"tumour.radius: expected at least half a cell, {size / 2:g} m, got "
            f"{radius:g} m; take smaller cells"
        )
    if radius > largest * (1 + 1e-9):
        raise ValueError(
            f"tumour.radius: expected within the grid, <= {largest:g} m, got "
            f"{radius:g} m; take a larger grid or move the tumour"
        )


def _free_radius(grid: Box, center: tuple[float, ...], sides: Sides) -> float:
    """Distance [m] of a point from the nearest side that is not insulated."""
    distances = [math.hypot(*grid.lengths)]
    for ends, x, length in zip(sides.along, center, grid.lengths, strict=False):
        low, high = (ends.low, ends.high) if isinstance(ends, Ends) else (None, None)
        distances += [x] * (low != "insulated")
        distances += [length - x] * (high != "insulated")
    return min(distances)
