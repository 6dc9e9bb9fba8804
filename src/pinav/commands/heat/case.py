"""Cases of `pinav heat`: what a TOML file may say, strictly."""

import tomllib
from pathlib import Path
from typing import Literal

import msgspec

from pinav.errors import InputError


class _Strict(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An unknown key is a mistake."""


class Sphere(_Strict, frozen=True, tag="sphere", tag_field="kind"):
    """A sphere, everything a function of the radius [m]."""

    radius: float
    cells: int


class Cylinder(_Strict, frozen=True, tag="cylinder", tag_field="kind"):
    """A long cylinder, everything a function of the radius [m]."""

    radius: float
    cells: int


class Box(_Strict, frozen=True, tag="box", tag_field="kind"):
    """Two or three axes with cubic cells of a size [m]."""

    cells: tuple[int, ...]
    size: float


class Flow(_Strict, frozen=True):
    """A perfusion: a number with its unit, or a law of Lang et al. by its tissue."""

    law: str | None = None
    value: float | None = None
    unit: str | None = None


class Medium(_Strict, frozen=True):
    """A tissue: a preset, or numbers in SI units, and its perfusion."""

    perfusion: Flow
    preset: str | None = None
    conductivity: float | None = None
    density: float | None = None
    specific_heat: float | None = None
    metabolic: float | None = None


class Tumour(_Strict, frozen=True):
    """A ball of another tissue; its centre [m] is that of the grid unless given."""

    radius: float
    tissue: Medium
    center: tuple[float, ...] | None = None


class Power(_Strict, frozen=True, tag="power", tag_field="kind"):
    """A power density [W/m³] at a reference amplitude [A/m].

    In the tumour, times `0.4 + (r/R)²` of equal power if `edge_weighted`; with a
    `width` [m] a Gaussian everywhere.
    """

    density: float
    reference: float
    width: float | None = None
    edge_weighted: bool = False


class Particles(_Strict, frozen=True, tag="particles", tag_field="kind"):
    """Magnetite in the tumour: concentration [mg/cm³], diameter [nm].

    `spread` is the standard deviation of the logarithm of the diameter.
    """

    concentration: float
    diameter: float
    bound: bool = True
    spread: float | None = None
    scale: float = 1.0


class Eddy(_Strict, frozen=True):
    """Eddy currents: radius of the body [m], conductivity [S/m]."""

    radius: float
    conductivity: float


class Wall(_Strict, frozen=True):
    """The outer sides: a temperature [°C], or an exchange [W/m²/K] with an ambient."""

    temperature: float | None = 37.0
    exchange: float | None = None
    ambient: float | None = None


class Field(_Strict, frozen=True):
    """Amplitudes [A/m] in intervals between times [s], at a frequency [Hz].

    `on` and `off` [s] make bursts of the one amplitude until the last time.
    """

    frequency: float
    times: tuple[float, ...]
    amplitudes: tuple[float, ...]
    on: float | None = None
    off: float | None = None


class Probes(_Strict, frozen=True):
    """Where [m] and how often [s] temperature is read."""

    points: tuple[tuple[float, ...], ...]
    every: float = 10.0


class Learn(_Strict, frozen=True):
    """What is learned, from a CSV file or from synthetic readings of the case."""

    laws: tuple[Literal["tissue", "tumour"], ...] = ("tissue", "tumour")
    kind: Literal["kernels", "network"] = "kernels"
    data: str | None = None
    noise: float = 0.1
    seed: int = 0
    power_scale: bool = False
    held_out: tuple[float, ...] = ()


class Optimise(_Strict, frozen=True):
    """What is free and what is bounded; temperatures in °C, doses in CEM43 minutes."""

    largest: float
    start: float = 0.5
    max_temperature: float = 47.0
    healthy_dose: float | None = None
    margin: float = 0.003
    placement: int | None = None


class Case(_Strict, frozen=True):
    """One case: tissue, heating and field, and what is asked."""

    title: str
    grid: Sphere | Cylinder | Box
    tissue: Medium
    heating: Power | Particles
    field: Field
    tumour: Tumour
    arterial: float = 37.0
    wall: Wall = Wall()
    eddy: Eddy | None = None
    limit: str | None = None
    probes: Probes | None = None
    learn: Learn | None = None
    optimise: Optimise | None = None
    step: float | None = None


def read_case(path: Path) -> tuple[Case, dict]:
    """A case and its content as it was written.

    Raises:
        InputError: the file cannot be read, or holds what no case has.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        return msgspec.convert(content, Case), content
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    except msgspec.ValidationError as error:
        raise InputError(f"{path}: {error}") from error
