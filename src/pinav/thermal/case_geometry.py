"""Tables of a case: grid, tumour, sides and probes, and what is asked."""

import math
from typing import Annotated, Literal

from msgspec import Meta

from pinav.thermal import boundaries, quantities
from pinav.thermal.grids import AbstractGrid, CartesianGrid, RadialGrid
from pinav.thermal.quantities import Strict, Table, read_module

Point = tuple[float, ...]
"""One coordinate along each axis [m]."""


class Sphere(Strict, frozen=True, tag="sphere", tag_field="kind"):
    """A sphere, everything a function of the radius [m]."""

    radius: quantities.Length
    cells: quantities.Cells

    def build(self) -> RadialGrid:
        return RadialGrid.sphere(self.radius, self.cells)


class Cylinder(Sphere, frozen=True, tag="cylinder", tag_field="kind"):
    """A long cylinder, everything a function of the radius [m]."""

    def build(self) -> RadialGrid:
        return RadialGrid.cylinder(self.radius, self.cells)


class Box(Strict, frozen=True, tag="box", tag_field="kind"):
    """Two or three axes with cells of a size [m], the same along all unless given."""

    cells: tuple[quantities.Cells, ...]
    size: quantities.Length | tuple[quantities.Length, ...]

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
        if isinstance(self.size, tuple):
            return self.size
        return (self.size,) * len(self.cells)

    def build(self) -> CartesianGrid:
        return CartesianGrid(self.cells, self.sizes)


class Voxels(Strict, frozen=True, tag="voxels", tag_field="kind"):
    """The voxels of an image whose values are labels of tissues.

    The size [m] along each axis is that of the file, if it has one.
    """

    labels: str
    size: tuple[quantities.Edge, ...] | None = None


Meshed = Sphere | Cylinder | Box
"""A grid whose cells are known without a file."""

Grid = Meshed | Voxels


Side = Table | str
"""One side, by the fields of a class of `boundaries`, such as `temperature`."""


class Ends(Strict, frozen=True):
    """Both sides across one axis of a box; the wall of the case unless given."""

    low: Side | None = None
    high: Side | None = None


Across = Ends | Literal["periodic"] | None
"""Both sides across an axis, or ends that meet."""


class SideTables(Strict, frozen=True):
    """The sides across each axis of a box."""

    x: Across = None
    y: Across = None
    z: Across = None

    @property
    def along(self) -> tuple[Across, Across, Across]:
        return self.x, self.y, self.z

    def build(
        self, wall: boundaries.AbstractBoundary, axes: int
    ) -> tuple[boundaries.AbstractEnds, ...]:
        return tuple(
            _ends(f"sides.{name}", ends, wall)
            for name, ends in tuple(zip("xyz", self.along, strict=True))[:axes]
        )


def read_boundary(key: str, side: Side) -> boundaries.AbstractBoundary:
    """The boundary that a table states."""
    return read_module(key, boundaries.BOUNDARIES, side)


def _ends(
    key: str, ends: Across, wall: boundaries.AbstractBoundary
) -> boundaries.AbstractEnds:
    if isinstance(ends, str):
        return boundaries.Periodic()
    low, high = (None, None) if ends is None else (ends.low, ends.high)
    return boundaries.Sides(
        wall if low is None else read_boundary(f"{key}.low", low),
        wall if high is None else read_boundary(f"{key}.high", high),
    )


class Probes(Strict, frozen=True):
    """Where [m] and how often [s] temperature is read."""

    points: tuple[tuple[quantities.Place, ...], ...]
    every: quantities.Time = 10.0

    def __post_init__(self) -> None:
        if len(set(self.points)) < len(self.points):
            raise ValueError("points: expected different places, got one twice")


def check_point(name: str, point: Point, lengths: Point) -> None:
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


def check_sides(grid: AbstractGrid, sides: SideTables) -> None:
    """Refuse sides that a grid does not have."""
    count = len(grid.shape) if len(grid.shape) > 1 else 0
    for name, ends in tuple(zip("xyz", sides.along, strict=True))[count:]:
        if ends is not None:
            raise ValueError(
                f"sides.{name}: expected no sides but of the axes of a box, of which "
                f"this grid has {count}; use wall on a sphere or cylinder"
            )


def check_ball(
    grid: AbstractGrid, radius: float, center: Point | None, sides: SideTables
) -> None:
    """Refuse a tumour that is not within the grid, or smaller than a cell.

    An insulated side is a plane of symmetry, through which a tumour may reach.
    """
    lengths: Point = grid.extent
    if isinstance(grid, CartesianGrid):
        middle = center or tuple(0.5 * length for length in lengths)
        check_point("tumour.center", middle, lengths)
        largest = _free_radius(lengths, middle, sides)
    elif center is not None:
        raise ValueError(
            "tumour.center: expected none on a sphere or cylinder, whose tumour is at "
            "its centre; take a box for another place"
        )
    else:
        largest = lengths[0]
    if radius < 0.5 * (size := max(grid.cell_sizes)):
        raise ValueError(
            f"tumour.radius: expected at least half a cell, {size / 2:g} m, got "
            f"{radius:g} m; take smaller cells"
        )
    if radius > largest * (1 + 1e-9):
        raise ValueError(
            f"tumour.radius: expected within the grid, <= {largest:g} m, got "
            f"{radius:g} m; take a larger grid or move the tumour"
        )


def _free_radius(lengths: Point, center: Point, sides: SideTables) -> float:
    """Distance [m] of a point from the nearest side that is not insulated."""
    distances = [math.hypot(*lengths)]
    for ends, x, length in zip(sides.along, center, lengths, strict=False):
        low, high = (ends.low, ends.high) if isinstance(ends, Ends) else (None, None)
        distances += [x] * (low != "insulated")
        distances += [length - x] * (high != "insulated")
    return min(distances)


class Frames(Strict, frozen=True):
    """MR thermometry: an image with frames, its noise [K], turns and drift.

    `temperature` in °C, `rise` in kelvins above the arteries, or `phase` in radians
    since the field was off, with the field of the magnet [T] and the echo time [s].
    `every` [s] is the time between frames, the first of which is as late; unless the
    file has it.
    """

    readings: str
    noise: Annotated[float, Meta(gt=0, le=quantities.NOISIEST)] | str
    quantity: Literal["temperature", "rise", "phase"] = "temperature"
    every: quantities.Time | None = None
    turn: Annotated[float, Meta(gt=0, le=1e4)] | None = None
    drift: Literal["none", "constant", "linear"] = "linear"
    magnet: Annotated[float, Meta(ge=0.01, le=30)] | None = None
    echo: Annotated[float, Meta(ge=1e-4, le=1)] | None = None
    coefficient: Annotated[float, Meta(ge=-1e-6, lt=0)] = -1e-8

    def __post_init__(self) -> None:
        phase = self.quantity == "phase"
        if phase is (self.magnet is None) or phase is (self.echo is None):
            raise ValueError(
                "expected magnet and echo with a phase, and with nothing else; give "
                "tesla and seconds, or remove them"
            )
        if phase and self.turn is not None:
            raise ValueError(
                "turn: expected none with a phase, whose turn follows from magnet and "
                "echo; remove it"
            )


class Learn(Strict, frozen=True):
    """What is learned, from probes, from voxels or from synthetic readings of the case.

    `power_scale` and `spot` are a factor of the power and where its map is; `until` [s]
    ends the readings that are fitted; `truth` is a case whose numbers made them.
    """

    laws: tuple[str, ...] | None = None
    kind: Literal["kernels", "network", "constant"] = "kernels"
    data: str | None = None
    thermometry: Frames | None = None
    noise: quantities.Noise = 0.1
    seed: quantities.Seed = 0
    power_scale: bool = False
    spot: bool = False
    until: quantities.Time | None = None
    truth: str | None = None
    held_out: tuple[Annotated[float, Meta(gt=0, le=100)], ...] = ()

    @property
    def is_synthetic(self) -> bool:
        """Whether the case itself is the truth of its readings."""
        return self.data is None and self.thermometry is None

    def __post_init__(self) -> None:
        if len(set(self.laws or ())) < len(self.laws or ()):
            raise ValueError(f"laws: expected each once, got {list(self.laws or ())}")
        if self.laws == () and not (self.power_scale or self.spot):
            raise ValueError(
                "expected something to learn, got no laws, power_scale or spot; name a "
                "tissue in laws"
            )
        if self.data is not None and self.thermometry is not None:
            raise ValueError("expected data or thermometry, got both; remove one")
        if self.held_out and not self.is_synthetic:
            raise ValueError(
                "held_out: expected none with data, whose truth is unknown; remove it"
            )
        if self.is_synthetic and (self.truth or self.until):
            raise ValueError(
                "truth, until: expected with data or thermometry alone; remove them"
            )


class Optimise(Strict, frozen=True):
    """What is free and what is bounded; temperatures in °C, doses in CEM43 minutes.

    The field is free `after` a time [s], at which it may switch; readings of `learn`
    until then say what the tissue is like.
    """

    largest: quantities.Reference
    start: quantities.Fraction = 0.5
    max_temperature: quantities.Celsius = 47.0
    healthy_dose: Annotated[float, Meta(gt=0, le=1e9)] | None = None
    margin: Annotated[float, Meta(ge=0, le=10)] = 0.003
    placement: Annotated[int, Meta(ge=2, le=100)] | None = None
    after: quantities.Time | None = None
