"""Numbers: what functions take, what a case may hold, and what to do about others."""

import dataclasses
import re
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import jax
import msgspec
import numpy as np
from jaxtyping import Array, Float
from msgspec import Meta

from pinav.errors import InputError

Number = float | int
"""One number that is never traced."""

Numbers = Sequence[Any] | np.ndarray | jax.Array
"""Several, nested lists among them."""

Field = Float[Array, "..."]
"""A number for each cell of a grid."""

Length = Annotated[float, Meta(gt=0, le=10)]
"""[m]"""
Edge = Annotated[float, Meta(ge=1e-5, le=0.05)]
"""[m], of a voxel; the bounds refuse millimetres."""
Place = Annotated[float, Meta(ge=-10, le=10)]
"""[m]"""
Time = Annotated[float, Meta(gt=0, le=1e7)]
"""[s]"""
Celsius = Annotated[float, Meta(ge=-50, le=100)]
"""[°C]; the bounds refuse kelvins."""
Arterial = Annotated[float, Meta(ge=10, le=45)]
"""[°C]"""
Amplitude = Annotated[float, Meta(ge=0, le=1e6)]
"""[A m⁻¹]; 1e6 are 1.3 T."""
Reference = Annotated[float, Meta(gt=0, le=1e6)]
"""[A m⁻¹]"""
Frequency = Annotated[float, Meta(ge=1e3, le=1e9)]
"""[Hz]; the bounds refuse kilohertz."""
Magnitude = Annotated[float, Meta(ge=0, le=1e15)]
PowerDensity = Annotated[float, Meta(ge=0, le=1e10)]
"""[W m⁻³]"""
Conductivity = Annotated[float, Meta(gt=0, le=1000)]
"""[W m⁻¹ K⁻¹]"""
Density = Annotated[float, Meta(ge=50, le=30_000)]
"""[kg m⁻³]; the bounds refuse grams per cubic centimetre."""
SpecificHeat = Annotated[float, Meta(ge=10, le=50_000)]
"""[J kg⁻¹ K⁻¹]; the bounds refuse kilojoules."""
Metabolic = Annotated[float, Meta(ge=0, le=1e7)]
"""[W m⁻³]"""
Exchange = Annotated[float, Meta(gt=0, le=1e6)]
"""[W m⁻² K⁻¹]"""
Energy = Annotated[float, Meta(ge=1e4, le=2e6)]
"""[J mol⁻¹]"""
LogFactor = Annotated[float, Meta(ge=0, le=1000)]
"""Logarithm of a factor in s⁻¹."""
Siemens = Annotated[float, Meta(gt=0, le=100)]
"""[S m⁻¹]"""
Concentration = Annotated[float, Meta(ge=0, le=5180)]
"""[mg cm⁻³]; solid magnetite has 5180."""
Scale = Annotated[float, Meta(ge=0, le=100)]
Fraction = Annotated[float, Meta(gt=0, le=1)]
NOISIEST = 100.0
"""Standard deviation [K] of a reading."""
Noise = Annotated[float, Meta(ge=0, le=NOISIEST)]
"""[K]"""
Seed = Annotated[int, Meta(ge=0, le=2**32 - 1)]
Cells = Annotated[int, Meta(ge=3, le=100_000)]


class Strict(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A table in which an unknown key is a mistake."""


_ADVICE = {
    "give seconds": "after attempt_time echo every off on step times until",
    "give metres": "axis center margin points radius size width",
    "give it in °C, which is kelvins less 273.15": (
        "ambient arterial max_temperature temperature"
    ),
    "give A/m; 1 mT are 796 A/m": "amplitudes largest ramp reference",
    "give a perfusion in its unit": "perfusion value",
    "give nanometres": "coating diameter",
    "give hertz": "frequencies frequency",
    "give W/kg": "absorption",
    "give the change of the shift per kelvin, about -1e-8": "coefficient",
    "give tesla": "magnet",
    "give the temperature in kelvin that a turn of the phase is": "turn",
    "give kJ/m³": "anisotropy",
    "give the number of cells along each axis": "cells",
    "give mg/cm³, the same as kg/m³": "concentration",
    "give W/(m K), or S/m of eddy currents": "conductivity",
    "give J/mol": "energy",
    "give the natural logarithm of the factor in 1/s": "log_factor",
    "give kg/m³ of a tissue, W/m³ of a power": "density",
    "give W/(m² K)": "exchange",
    "give CEM43 minutes": "healthy_dose",
    "give powers relative to that of the fit": "held_out",
    "give kA/m": "magnetisation",
    "give W/m³": "metabolic",
    "give the standard deviation of a reading in kelvin": "noise",
    "give W/g": "slp",
    "give kg/m³": "solid_density",
    "give J/(kg K)": "specific_heat",
    "give the standard deviation of the logarithm of the diameter": "spread",
    "give a fraction of the largest amplitude": "start",
    "give Pa s": "viscosity",
}

ADVICE = {key: advice for advice, keys in _ADVICE.items() for key in keys.split()}
"""What a number under a key is; keys of the same name are of the same kind."""


Table = dict[str, Any]
"""A table that is read by the fields of a class of this package."""

Kind = TypeVar("Kind")


def read_module(key: str, classes: tuple[type[Kind], ...], table: Table | str) -> Kind:
    """The module that a table states: that of whose fields its keys are the names.

    A class without fields is stated by a word, its name in small letters. Numbers must
    lie within the `range` in the metadata of their field.
    """
    words = {c.__name__.lower(): c for c in classes if not _fields(c)}
    if isinstance(table, str) and table in words:
        return words[table]()
    for cls in classes:
        fields = _fields(cls)
        needed = {n for n, f in fields.items() if f.default is dataclasses.MISSING}
        if isinstance(table, dict) and fields and needed <= set(table) <= set(fields):
            parts = {
                name: within(f"{key}.{name}", fields[name].metadata["range"], part)
                for name, part in table.items()
            }
            try:
                return cls(**parts)
            except InputError as error:
                raise ValueError(f"{key}: {error}") from error
    choices = [
        " and ".join(
            name if field.default is dataclasses.MISSING else f"({name})"
            for name, field in _fields(cls).items()
        )
        for cls in classes
        if _fields(cls)
    ]
    got = repr(table) if isinstance(table, str) else ", ".join(table) or "none"
    raise ValueError(
        f"{key}: expected the keys {', or '.join((*choices, *map(repr, words)))}; got "
        f"{got}"
    )


def _fields(cls: Any) -> Mapping[str, dataclasses.Field]:
    return {f.name: f for f in dataclasses.fields(cls) if "range" in f.metadata}


def within(key: str, numbers: Any, value: Any) -> Any:
    """A value that lies within an annotated range."""
    try:
        return msgspec.convert(value, numbers)
    except msgspec.ValidationError as error:
        place, words = key, str(error)
        if inner := PLACE.fullmatch(words):
            words, place = inner[1], key + inner[2]
        raise ValueError(refusal(place, words, value)) from error


PLACE = re.compile(r"(.*) - at `\$\.?(.*)`")
BOUND = re.compile(r"Expected `(?:float|int)` ([<>]\S* \S+)")
KEY = re.compile(r"[a-z_]+: ")


def refusal(place: str, message: str, value: Any) -> str:
    """What msgspec says of a value, with its key first and how to mend it."""
    if bound := BOUND.fullmatch(message):
        key = re.findall(r"[a-z_]+", place)[-1]
        advice = f"; {ADVICE[key]}" if key in ADVICE else ""
        words = f"expected a number {bound[1].removesuffix('.0')}"
        return f"{place}: {words}, got {value}{advice}"
    # a table that checks itself may have named the key within it
    joint = "." if KEY.match(message) else ": "
    return joint.join((place, message)) if place else message


def explain(message: str, content: Any) -> str:
    """A message of msgspec on nested tables, with the key first."""
    if not (place := PLACE.fullmatch(message)):
        return message
    return refusal(place[2], place[1], _value_at(content, place[2]))


def _value_at(content: Any, place: str) -> Any:
    """The entry of nested tables and lists at a path such as `field.times[1]`."""
    for name, index in re.findall(r"(\w+)|\[(\d+)\]", place):
        if (name and name not in content) or not content:
            return None
        content = content[name] if name else content[int(index)]
    return content


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of an npz file by their names; that of an npy file has an empty one.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        with open(path, "rb") as file:
            content = np.load(file, allow_pickle=False)
            if isinstance(content, np.ndarray):
                return {"": content}
            with content:
                return dict(content)
    except (
        OSError,
        ValueError,
        EOFError,
        MemoryError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
