"""A run of bioheat as the page takes it."""

import dataclasses

import numpy as np

from pinav.commands.explore.plan import RESULT
from pinav.commands.explore.printing import Tree, pack_array
from pinav.commands.explore.sections import RESULTS, section_payload
from pinav.errors import InputError
from pinav.runs import RunFolder
from pinav.thermal.heated_run import AbstractHeatResult, HeatedRun, RadialBalance
from pinav.thermal.planned_run import PlannedRun


def is_heated(folder: RunFolder) -> bool:
    """Whether the run is one of bioheat: it has temperatures and no model."""
    if folder.models() or not folder.has(RESULTS):
        return False
    return "temperature" in folder.read_arrays(RESULTS)


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
