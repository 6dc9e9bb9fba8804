"""The plan of a navigation as the page takes it: goal, walls, and time to go."""

from pathlib import Path

import numpy as np

from pinav.commands.explore.printing import Tree, pack_array
from pinav.errors import InputError
from pinav.runs import RunFolder

RESULTS = "results.npz"

LEVELS = 65535
"""Steps of a value of the plan."""


def fit_of_plan(folder: RunFolder, stated: Path | None) -> Path:
    """The run of the model that a plan was made with.

    Args:
        folder: of the plan.
        stated: where that run is; the one of its name beside the plan unless given.

    Raises:
        InputError: it is not there.
    """
    name = folder.identity().get("fitted", "")
    beside = folder.path.resolve().parent / name
    fit = beside if stated is None else stated
    if not RunFolder(fit).exists():
        raise InputError(
            f"{folder.path}: expected the run {name!r} that it was planned with beside "
            "it; name that folder with --fit"
        )
    return fit


def plan_of(folder: RunFolder) -> Tree:
    """The plan of a run as the page takes it.

    Raises:
        InputError: the run has none, or was written before plans were kept.
    """
    folder.check_file(RESULTS)
    arrays = folder.read_arrays(RESULTS)
    if "plan/values" not in arrays:
        raise InputError(
            f"{folder.path}: its results hold no plan that can be evaluated; "
            f"{folder.repair(RESULTS)}"
        )
    plan = {
        name: np.asarray(arrays[name], float).tolist()
        for name in ("arena", "start", "goal", "tolerance", "discs", "step")
    }
    for name in ("lower", "spacing", "scale", "ahead", "horizon", "thrusts"):
        plan[name] = np.asarray(arrays[f"plan/{name}"], float).tolist()
    # Between zero and one: sixteen bits are finer than the lattice is right.
    levels = np.round(np.clip(arrays["plan/values"], 0.0, 1.0) * LEVELS)
    plan["values"] = pack_array(levels, "u2")
    if "suggestion" in arrays:
        plan["suggestion"] = arrays["suggestion"].tolist()
    return plan


def is_plan(folder: RunFolder) -> bool:
    """Whether the run has a plan on the model of another run, and no model itself."""
    return not folder.models() and bool(folder.identity().get("fitted"))
