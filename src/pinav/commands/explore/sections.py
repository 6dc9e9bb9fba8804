"""A run of bioheat on a plane or in a box as the page takes it: sections over time."""

import math
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from pinav.commands.explore.printing import Tree, pack_array
from pinav.errors import InputError
from pinav.runs import RunFolder

RESULTS = "results.npz"

NUMBERS = 300_000
"""Temperatures that the page holds at most, of two bytes each."""

SIDE = 160
"""Cells along a side of a section at most; of finer ones each second is taken."""

LEVELS = 65534
"""Steps between the least and the greatest number; one more stands for none."""

LEAST_DOSE = 1e-3
"""Dose [CEM43 min] below which the map of its logarithm says no less."""

CURVES = ("hottest", "T10", "T50", "T90", "dose/D90", "dose/outside")


def section_payload(folder: RunFolder, arrays: Mapping[str, np.ndarray]) -> Tree:
    """A run of bioheat on a plane or in a box as the page takes it.

    Args:
        folder: of the run.
        arrays: its results.

    Raises:
        InputError: the run was written before temperatures were kept over time.
    """
    if "section/times" not in arrays:
        raise InputError(
            f"{folder.path}: its results hold no temperatures over time; "
            f"{folder.repair(RESULTS)}"
        )
    names = [name for name in ("z", "y", "x") if f"section/{name}" in arrays]
    planes = dict(zip(names, arrays["section/indices"].tolist(), strict=True))
    moments = arrays["section/times"]
    cells = sum(thin(arrays[f"section/{name}"][0]).size for name in names)
    kept = _kept(len(moments), max(NUMBERS // cells, 2))
    fields = {n: thin(arrays[f"section/{n}"][kept]) for n in names}
    limits = _limits(*fields.values())
    return {
        "version": 1,
        "kind": "sections",
        "title": f"Bioheat: {folder.path.name}",
        "run": folder.path.name,
        "limits": limits,
        "moments": pack_array(moments[kept], "f8"),
        "sections": [
            {
                **_place(name, index, arrays),
                "temperature": _levels(fields[name], limits),
                "dose": _dose(_cut(arrays["dose"], name, index)),
                "target": pack_array(thin(_cut(arrays["target"], name, index))),
            }
            for name, index in planes.items()
        ],
        "points": np.asarray(arrays["points"], float).tolist(),
        "edges": arrays["edges"].tolist(),
        "starts": arrays["starts"].tolist(),
        "ends": arrays["ends"].tolist(),
        "times": pack_array(arrays["times"]),
        "curves": {name: pack_array(arrays[name]) for name in CURVES},
        "probes": [pack_array(line) for line in np.asarray(arrays.get("probes", [])).T],
    }


def thin(plane: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Sections with at most `SIDE` cells along each side, the last two axes."""
    every = math.ceil(max(plane.shape[-2:]) / SIDE)
    return plane[..., ::every, ::every]


def _kept(count: int, most: int) -> np.ndarray:
    """Indices of at most so many of `count` moments, evenly, both ends among them."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int))


def _place(name: str, index: int, arrays: Mapping[str, np.ndarray]) -> Tree:
    """Where a section lies: the axes along it, its sides and its height [m]."""
    axis = "xyz".index(name)
    spacing, shape = arrays["spacing"], arrays["target"].shape
    along = [a for a in range(len(shape)) if a != axis]
    return {
        "normal": name,
        "axes": ["xyz"[a] for a in along],
        "sides": [float(spacing[a] * shape[a]) for a in along],
        "at": None if index < 0 else float(spacing[axis] * (index + 0.5)),
    }


def _cut(field: np.ndarray, name: str, index: int) -> np.ndarray:
    return field if index < 0 else np.take(field, index, axis="xyz".index(name))


def _limits(*fields: np.ndarray) -> tuple[float, float]:
    low = min(float(np.nanmin(field)) for field in fields)
    high = max(float(np.nanmax(field)) for field in fields)
    return low, high if high > low else low + 1.0


def _levels(field: np.ndarray, limits: tuple[float, float]) -> Tree:
    """A field in steps of a 65 534th of its range."""
    low, high = limits
    steps = np.round((field - low) / (high - low) * LEVELS)
    return pack_array(np.where(np.isnan(steps), LEVELS + 1, steps), "u2")


def _dose(dose: np.ndarray) -> Tree:
    """The logarithm of a dose, and the range of its steps."""
    logarithm = np.log10(np.maximum(thin(dose), LEAST_DOSE))
    limits = _limits(logarithm)
    return {"limits": limits, "levels": _levels(logarithm, limits)}
