"""A run of bioheat as the page takes it."""

import dataclasses
import math

import numpy as np
from jaxtyping import Float

from pinav.commands.explore.payload import RESULT
from pinav.commands.explore.printing import Tree, pack_array
from pinav.errors import InputError
from pinav.runs import RunFolder
from pinav.thermal.heated_run import AbstractHeatResult, HeatedRun, Plane, RadialBalance
from pinav.thermal.planned_run import PlannedRun


def heat_payload(folder: RunFolder) -> Tree:
    """A run of bioheat, or a planned one, as the page takes it.

    Raises:
        InputError: its result is damaged, or is none that the page can show.
    """
    found = folder.load(RESULT, AbstractHeatResult)
    run = found.result if isinstance(found, PlannedRun) else found
    if not isinstance(run, HeatedRun):
        raise InputError(
            f"{folder.path}: expected a run of bioheat, or a planned one, got a fit"
        )
    title = f"Bioheat: {folder.path.name}"
    names = {"version": 1, "title": title, "run": folder.path.name}
    field = {
        "edges": list(run.protocol.edges),
        "starts": np.asarray(run.protocol.starts).tolist(),
        "ends": np.asarray(run.protocol.ends).tolist(),
        "times": pack_array(run.times),
    }
    if run.balance is None:
        return {**names, **field, **section_payload(run)}
    return {**names, **field, **_radial_payload(run, run.balance)}


def _radial_payload(run: HeatedRun, balance: RadialBalance) -> Tree:
    """A run along a radius, with all that its heat equation needs."""
    assert run.radius is not None
    assert run.profiles is not None
    parts = {f.name: getattr(balance, f.name) for f in dataclasses.fields(balance)}
    return {
        "kind": "tissue",
        "balance": {
            name: pack_array(values, "f4" if values.ndim > 1 else "f8")
            for name, values in parts.items()
        },
        "radius": pack_array(run.radius, "f8"),
        "target": pack_array(run.target),
        "probes": np.linalg.norm(run.points, axis=-1).tolist(),
        "hottest": pack_array(run.temperatures["hottest"]),
        "field": pack_array(run.profiles[:: max(len(run.times) // 60, 1)]),
        "dose": pack_array(run.doses["D90"]),
    }


NUMBERS = 300_000
"""Temperatures that the page holds at most, of two bytes each."""

SIDE = 160
"""Cells along a side of a section at most; of finer ones each second is taken."""

LEVELS = 65534
"""Steps between the least and the greatest number; one more stands for none."""

LEAST_DOSE = 1e-3
"""Dose [CEM43 min] below which the map of its logarithm says no less."""


def section_payload(run: HeatedRun) -> Tree:
    """The planes of a run in a box, and its curves, as the page takes them."""
    moments = run.moments
    assert moments is not None
    cells = sum(thin(plane.temperatures[0]).size for plane in run.planes)
    count = min(max(NUMBERS // cells, 2), len(moments))
    kept = np.unique(np.linspace(0, len(moments) - 1, count).round().astype(int))
    fields = [thin(plane.temperatures[kept]) for plane in run.planes]
    limits = _limits(*fields)
    doses = {f"dose/{name}": curve for name, curve in run.doses.items()}
    curves = {name: pack_array(c) for name, c in (run.temperatures | doses).items()}
    probes = [] if run.probes is None else run.probes.T
    return {
        "kind": "sections",
        "limits": limits,
        "moments": pack_array(moments[kept], "f8"),
        "sections": [
            {
                **_place(plane, run),
                "temperature": _levels(field, limits),
                "dose": _dose(plane.cut.of(run.dose)),
                "target": pack_array(thin(plane.cut.of(run.target))),
            }
            for plane, field in zip(run.planes, fields, strict=True)
        ],
        "points": run.points.tolist(),
        "curves": curves,
        "probes": [pack_array(line) for line in probes],
    }


def thin(plane: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Sections with at most `SIDE` cells along each side, the last two axes."""
    every = math.ceil(max(plane.shape[-2:]) / SIDE)
    return plane[..., ::every, ::every]


def _place(plane: Plane, run: HeatedRun) -> Tree:
    """Position of a section: the axes along it, its sides and its height [m]."""
    axis, place = plane.cut
    spacing, shape = run.spacing, run.target.shape
    along = [a for a in range(len(shape)) if a != axis]
    return {
        "normal": "xyz"[axis],
        "axes": ["xyz"[a] for a in along],
        "sides": [float(spacing[a] * shape[a]) for a in along],
        "at": None if place is None else spacing[axis] * (place + 0.5),
    }


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
