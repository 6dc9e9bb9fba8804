"""Learned constants by the names that tables and files give them."""

from pinav.evaluation import field_map
from pinav.fitting import (
    Estimate,
    EvidenceFit,
    principal_drags,
    rotational_fraction,
)
from pinav.fitting.environments.choice import CONSTANTS, ModelChoice
from pinav.forces import as_learned_force, split_structure
from pinav.trajectories import Trajectories


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
