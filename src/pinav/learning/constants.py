"""Learned constants by the names that tables and files give them, with their units."""

import re
from collections.abc import Mapping
from typing import Any

from pinav.arguments import dimension_of
from pinav.evaluation import field_map
from pinav.fitting import (
    Estimate,
    EvidenceFit,
    principal_drags,
    rotational_fraction,
)
from pinav.fitting.environments.choice import CONSTANTS, ModelChoice
from pinav.forces import as_learned_force, split_structure
from pinav.systems import System, WanderingVelocity
from pinav.trajectories import Trajectories
from pinav.units import unit_of

DIMENSIONS = {
    "diffusion": "L2 T-1",
    "exposure": "T",
    "error": "L",
    "rotational fraction": "1",
    "noise of a block": "L",
}
"""Dimension of what a fit learns beside the numbers of a swimmer."""


def with_units(
    estimates: Mapping[str, Estimate], choice: ModelChoice, model: Any, system: System
) -> dict[str, Estimate]:
    """Learned constants with their units.

    Args:
        estimates: by name.
        choice: what was fitted, which says where a constant stands in the model.
        model: the fitted model, whose fields say their units.
        system: which says the units of length, time and force.
    """
    stated = system.base_units
    units = {"L": stated.length, "T": stated.time, "F": stated.force}
    paths = choice.paths()
    return {
        name: Estimate(
            float(one.value),
            float(one.sd),
            unit_of(_in_order(_dimension(name, paths, model), system), units),
        )
        for name, one in estimates.items()
    }


def _in_order(dimension: str, system: System) -> str:
    """The dimension of a mass-specific force where a force is none of these.

    Without inertia a force L T-2 is a force F, or a velocity L T-1 where the mobility
    has no unit.
    """
    words = dimension.split()
    if system.order == 2 or "T-2" not in words:
        return dimension
    others = [word for word in words if word != "T-2"]
    if system.base_units.force == "1":
        return " ".join([*others, "T-1"])
    return " ".join([*others, "L-1", "F"])


def _dimension(name: str, paths: Mapping[str, str], model: Any) -> str:
    plain = re.sub(r"\[.*\]$", "", name)
    if plain in DIMENSIONS:
        return DIMENSIONS[plain]
    if plain.startswith("wandering."):
        return dimension_of(WanderingVelocity, plain.removeprefix("wandering."))
    path = CONSTANTS["drag"] if name.startswith("drag ") else paths.get(name, name)
    return dimension_of(model, path)


def estimated_constants(fit: EvidenceFit, choice: ModelChoice) -> dict[str, Estimate]:
    """Each learned constant, by its name; the drag by its principal values."""
    paths = choice.paths()
    estimates = {
        name: estimate
        for name, estimate in fit.constants.items()
        if not name.startswith("environment.terms")
    }
    named = {
        name: estimates.pop(path)
        for name, path in paths.items()
        if path in estimates and path != CONSTANTS["drag"]
    }
    if CONSTANTS["drag"] in paths.values():
        drags = principal_drags(fit.posterior)
        return named | {f"drag {name}": value for name, value in drags.items()}
    return named | estimates


def rotational_part(fit: EvidenceFit, data: Trajectories) -> dict[str, Estimate]:
    """The rotational fraction of a mixture where there are data; else nothing."""
    environment = fit.model.environment
    learned = as_learned_force(environment)
    if learned is None or learned.helmholtz is None or split_structure(learned)[0]:
        return {}
    field = field_map(environment, data)
    visited = field.points[field.distance.ravel() <= field.regions.visited]
    return {"rotational fraction": rotational_fraction(fit.posterior, visited)}
