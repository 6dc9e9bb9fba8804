"""Cases of `pinav heat`: what a TOML file may say, strictly."""

import math
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from pinav.errors import InputError

Length = Annotated[float, Meta(gt=0, le=10)]
"""[m]"""
Place = Annotated[float, Meta(ge=-10, le=10)]
"""[m]"""
Time = Annotated[float, Meta(gt=0, le=1e7)]
"""[s]"""
Celsius = Annotated[float, Meta(ge=-50, le=100)]
"""[°C]; the bounds refuse kelvins."""
Amplitude = Annotated[float, Meta(ge=0, le=1e9)]
"""[A m⁻¹]"""
Positive = Annotated[float, Meta(gt=0, le=1e15)]
Magnitude = Annotated[float, Meta(ge=0, le=1e15)]
Finite = Annotated[float, Meta(ge=-1e15, le=1e15)]
Cells = Annotated[int, Meta(ge=3, le=100_000)]

MOST_CELLS = 4_000_000
"""Cells of a grid beyond which a run does not fit the memory of a usual machine."""


class _Strict(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An unknown key is a mistake."""


class _Round(_Strict, frozen=True):
    """A grid over the radius [m]."""

    radius: Length
    cells: Cells

    @property
    def lengths(self) -> tuple[float, ...]:
        """Extent along each axis [m]."""
        return (self.radius,)

    @property
    def size(self) -> float:
        """Size of a cell [m]."""
        return self.radius / self.cells


class Sphere(_Round, frozen=True, tag="sphere", tag_field="kind"):
    """A sphere, everything a function of the radius [m]."""


class Cylinder(_Round, frozen=True, tag="cylinder", tag_field="kind"):
    """A long cylinder, everything a function of the radius [m]."""


class Box(_Strict, frozen=True, tag="box", tag_field="kind"):
    """Two or three axes with cubic cells of a size [m]."""

    cells: tuple[Cells, ...]
    size: Length

    def __post_init__(self) -> None:
        if len(self.cells) not in (2, 3):
            raise ValueError(
                f"cells: expected two or three numbers, got {len(self.cells)}; take a "
                "sphere or a cylinder for one axis"
            )
        if (count := math.prod(self.cells)) > MOST_CELLS:
            raise ValueError(
                f"cells: expected at most {MOST_CELLS:,} in all, got {count:,}; take "
                "larger cells"
            )

    @property
    def lengths(self) -> tuple[float, ...]:
        """Extent along each axis [m]."""
        return tuple(count * self.size for count in self.cells)


class Flow(_Strict, frozen=True):
    """A perfusion: a number with its unit, or a law of Lang et al. by its tissue."""

    law: str | None = None
    value: Magnitude | None = None
    unit: str | None = None


class Medium(_Strict, frozen=True):
    """A tissue: a preset, or numbers in SI units, and its perfusion."""

    perfusion: Flow
    preset: str | None = None
    conductivity: Finite | None = None
    density: Finite | None = None
    specific_heat: Finite | None = None
    metabolic: Finite | None = None


class Tumour(_Strict, frozen=True):
    """A ball of another tissue; its centre [m] is that of the grid unless given."""

    radius: Length
    tissue: Medium
    center: tuple[Place, ...] | None = None


class Power(_Strict, frozen=True, tag="power", tag_field="kind"):
    """A power density [W/m³] at a reference amplitude [A/m].

    In the tumour, times `0.4 + (r/R)²` of equal power if `edge_weighted`; with a
    `width` [m] a Gaussian everywhere.
    """

    density: Magnitude
    reference: Positive
    width: Length | None = None
    edge_weighted: bool = False


class Particles(_Strict, frozen=True, tag="particles", tag_field="kind"):
    """Magnetite in the tumour: concentration [mg/cm³], diameter [nm].

    `spread` is the standard deviation of the logarithm of the diameter.
    """

    concentration: Magnitude
    diameter: Annotated[float, Meta(ge=1, le=1000)]
    bound: bool = True
    spread: Annotated[float, Meta(gt=0, le=3)] | None = None
    scale: Magnitude = 1.0


class Eddy(_Strict, frozen=True):
    """Eddy currents: radius of the body [m], conductivity [S/m]."""

    radius: Length
    conductivity: Positive


class Wall(_Strict, frozen=True):
    """The outer sides: a temperature [°C], or an exchange [W/m²/K] with an ambient.

    Unless one of them is given, the wall is at 37 °C.
    """

    temperature: Celsius | None = None
    exchange: Magnitude | None = None
    ambient: Celsius | None = None

    def __post_init__(self) -> None:
        if (self.exchange is None) != (self.ambient is None):
            raise ValueError(
                "expected an ambient temperature with an exchange, and an exchange "
                "with an ambient temperature"
            )
        if self.temperature is not None and self.exchange is not None:
            raise ValueError("expected a temperature or an exchange, got both")


class Field(_Strict, frozen=True):
    """Amplitudes [A/m] in intervals between times [s], at a frequency [Hz].

    `on` and `off` [s] make bursts of the one amplitude until the last time.
    """

    frequency: Positive
    times: tuple[Annotated[float, Meta(ge=0, le=1e7)], ...]
    amplitudes: tuple[Amplitude, ...]
    on: Time | None = None
    off: Time | None = None

    def __post_init__(self) -> None:
        if len(self.times) < 2 or self.times[0] != 0:
            raise ValueError(
                f"times: expected 0 and one later time or more, got {list(self.times)}"
            )
        if not all(a < b for a, b in zip(self.times, self.times[1:], strict=False)):
            raise ValueError(
                f"times: expected increasing times, got {list(self.times)}"
            )
        if (self.on is None) != (self.off is None):
            raise ValueError("expected on and off together, got one of them")
        count = 1 if self.on is not None else len(self.times) - 1
        if len(self.amplitudes) != count:
            raise ValueError(
                f"amplitudes: expected {count}, one for each interval between two "
                f"times, or one for bursts; got {len(self.amplitudes)}"
            )


class Probes(_Strict, frozen=True):
    """Where [m] and how often [s] temperature is read."""

    points: tuple[tuple[Place, ...], ...]
    every: Time = 10.0


class Learn(_Strict, frozen=True):
    """What is learned, from a CSV file or from synthetic readings of the case."""

    laws: tuple[Literal["tissue", "tumour"], ...] = ("tissue", "tumour")
    kind: Literal["kernels", "network"] = "kernels"
    data: str | None = None
    noise: Annotated[float, Meta(ge=0, le=100)] = 0.1
    seed: Annotated[int, Meta(ge=0)] = 0
    power_scale: bool = False
    held_out: tuple[Positive, ...] = ()


class Optimise(_Strict, frozen=True):
    """What is free and what is bounded; temperatures in °C, doses in CEM43 minutes."""

    largest: Positive
    start: Annotated[float, Meta(ge=0, le=1)] = 0.5
    max_temperature: Celsius = 47.0
    healthy_dose: Positive | None = None
    margin: Annotated[float, Meta(ge=0, le=10)] = 0.003
    placement: Annotated[int, Meta(ge=1, le=100)] | None = None


class Case(_Strict, frozen=True):
    """One case: tissue, heating and field, and what is asked."""

    title: str
    grid: Sphere | Cylinder | Box
    tissue: Medium
    heating: Power | Particles
    field: Field
    tumour: Tumour
    arterial: Annotated[float, Meta(ge=0, le=60)] = 37.0
    wall: Wall = Wall()
    eddy: Eddy | None = None
    limit: str | None = None
    probes: Probes | None = None
    learn: Learn | None = None
    optimise: Optimise | None = None
    step: Time | None = None

    def __post_init__(self) -> None:
        self._check_tumour()
        if self.probes is not None:
            for point in self.probes.points:
                self._check_point("probes.points", point)

    def _check_tumour(self) -> None:
        radius, center = self.tumour.radius, self.tumour.center
        lengths = self.grid.lengths
        round_grid = len(lengths) == 1
        if center is not None:
            if round_grid:
                raise ValueError(
                    "tumour.center: expected none on a sphere or cylinder, whose "
                    "tumour is at its centre; take a box for another place"
                )
            self._check_point("tumour.center", center)
        if radius < 0.5 * self.grid.size:
            raise ValueError(
                f"tumour.radius: expected at least half a cell, {self.grid.size / 2:g} "
                f"m, got {radius:g} m; take smaller cells"
            )
        largest = lengths[0] if round_grid else 0.5 * min(lengths)
        if radius > largest:
            raise ValueError(
                f"tumour.radius: expected within the grid, <= {largest:g} m, got "
                f"{radius:g} m"
            )

    def _check_point(self, name: str, point: Sequence[float]) -> None:
        lengths = self.grid.lengths
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


def read_case(path: Path) -> tuple[Case, dict[str, Any]]:
    """A case and its content as it was written.

    Raises:
        InputError: the file cannot be read, or holds what no case has.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    try:
        return msgspec.convert(content, Case), content
    except msgspec.ValidationError as error:
        raise InputError(f"{path}: {_explain(str(error), content)}") from error


BOUND = re.compile(r"Expected `(?:float|int)` (\S+ \S+) - at `\$\.?(.*)`")
ELSEWHERE = re.compile(r"(.*) - at `\$\.?(.*)`")


def _explain(message: str, content: object) -> str:
    """A message of msgspec with the key first, and the value that misses a bound."""
    if bound := BOUND.fullmatch(message):
        words = f"expected a number {bound[1].removesuffix('.0')}"
        return f"{bound[2]}: {words}, got {_value_at(content, bound[2])}"
    if place := ELSEWHERE.fullmatch(message):
        return f"{place[2]}: {place[1]}" if place[2] else place[1]
    return message


def _value_at(content: Any, place: str) -> Any:
    """The entry of nested tables and lists at a path such as `field.times[1]`."""
    for name, index in re.findall(r"(\w+)|\[(\d+)\]", place):
        content = content[name] if name else content[int(index)]
    return content
