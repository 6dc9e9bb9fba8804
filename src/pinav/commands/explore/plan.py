"""The plan of a navigation as the page takes it: goal, walls, and time to go."""

from pathlib import Path

import numpy as np

from pinav.commands.explore.printing import Tree, pack_array
from pinav.errors import InputError
from pinav.navigation import AbstractNavigation, Navigation
from pinav.runs import RunFolder

RESULT = "metrics"
"""Files of the result of a navigation, without ending."""

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
        InputError: the run has none, such as one in space.
    """
    result: AbstractNavigation = folder.load(RESULT, AbstractNavigation)
    if not isinstance(result, Navigation) or result.plan.lattice is None:
        raise InputError(
            f"{folder.path}: its results hold no plan that can be evaluated; expected "
            "one in the plane, of a learned model"
        )
    course, lattice = result.course, result.plan.lattice
    plan: Tree = {
        "arena": course.arena.tolist(),
        "start": course.start.tolist(),
        "goal": course.goal.tolist(),
        "tolerance": course.tolerance,
        "discs": course.discs.tolist(),
        "step": result.step,
        "lower": lattice.lower.tolist(),
        "spacing": lattice.spacing.tolist(),
        "scale": lattice.scale,
        "ahead": lattice.ahead,
        "horizon": lattice.horizon,
        "thrusts": lattice.thrusts.tolist(),
    }
    # Between zero and one: sixteen bits are finer than the lattice is right.
    levels = np.round(np.clip(lattice.values, 0.0, 1.0) * LEVELS)
    plan["values"] = pack_array(levels, "u2")
    if result.suggestion is not None and result.suggestion.path is not None:
        plan["suggestion"] = result.suggestion.path.tolist()
    return plan


def is_plan(folder: RunFolder) -> bool:
    """Whether the run has a plan on the model of another run, and no model itself."""
    return not folder.models() and bool(folder.identity().get("fitted"))
