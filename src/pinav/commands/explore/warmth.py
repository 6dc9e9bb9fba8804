"""A run of bioheat as the page takes it."""

from collections.abc import Mapping

import numpy as np

from pinav.commands.explore.printing import Tree, pack_array
from pinav.commands.explore.sections import RESULTS, section_payload
from pinav.errors import InputError
from pinav.runs import RunFolder


def is_heated(folder: RunFolder) -> bool:
    """Whether the run is one of bioheat: it has temperatures and no model."""
    if folder.models() or not folder.has(RESULTS):
        return False
    return "temperature" in folder.read_arrays(RESULTS)


def heat_payload(folder: RunFolder) -> Tree:
    """A run of bioheat as the page takes it.

    Raises:
        InputError: it was written before the page could show it.
    """
    folder.check_file(RESULTS)
    arrays = folder.read_arrays(RESULTS)
    if "radius" not in arrays:
        return section_payload(folder, arrays)
    return _radial_payload(folder, arrays)


def _radial_payload(folder: RunFolder, arrays: Mapping[str, np.ndarray]) -> Tree:
    """A run along a radius, with all that its heat equation needs."""
    if "balance/conductances" not in arrays:
        raise InputError(
            f"{folder.path}: its results hold no heat balance; {folder.repair(RESULTS)}"
        )
    parts = {
        name.removeprefix("balance/"): pack_array(
            values, "f4" if values.ndim > 1 else "f8"
        )
        for name, values in arrays.items()
        if name.startswith("balance/")
    }
    points = arrays["points"]
    return {
        "version": 1,
        "kind": "tissue",
        "title": f"Bioheat: {folder.path.name}",
        "run": folder.path.name,
        "balance": parts,
        "radius": pack_array(arrays["radius"], "f8"),
        "target": pack_array(arrays["target"]),
        "probes": np.linalg.norm(points, axis=-1).tolist() if len(points) else [],
        "edges": arrays["edges"].tolist(),
        "starts": arrays["starts"].tolist(),
        "ends": arrays["ends"].tolist(),
        "times": pack_array(arrays["times"]),
        "hottest": pack_array(arrays["hottest"]),
        "field": pack_array(arrays["field"][:: max(len(arrays["times"]) // 60, 1)]),
        "dose": pack_array(arrays["dose/D90"]),
    }
