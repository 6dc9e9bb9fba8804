"""The learned force of a fit as arrays, beside its truth where that is known."""

from typing import Any

import numpy as np

from pinav.commands.fit.plan import FitPlan
from pinav.commands.fitted_run import FittedRun
from pinav.dynamics import AbstractDynamics
from pinav.evaluation import (
    FieldMap,
    default_regions,
    field_map,
    force_error_at_samples,
    force_errors,
    force_line,
)
from pinav.fitting.environments.choice import KnownSwimmer
from pinav.forces import AbstractForce
from pinav.scenarios import source_system


def force_fields(model: KnownSwimmer, plan: FitPlan) -> dict[str, FieldMap]:
    """The learned force around the data, and the true one where it is known."""
    fields = {"learned": field_map(model.environment, plan.data)}
    truth = true_environment(plan)
    if truth is not None:
        fields["true"] = field_map(truth, plan.data)
    return fields


def true_environment(plan: FitPlan) -> AbstractForce | None:
    """That of the system from which the data come, where it is known."""
    source = source_system(plan.data.provenance)
    return None if source is None else source.environment


def error_of_force(
    model: AbstractDynamics, fields: dict[str, FieldMap], plan: FitPlan
) -> dict[str, float | None] | None:
    """Errors of the force by region, where its truth is known.

    Args:
        model: that was fitted.
        fields: those of `force_fields`.
        plan: of the fit.
    """
    if plan.data.dim != 2 and isinstance(model, KnownSwimmer):
        truth = true_environment(plan)
        if truth is None:
            return None
        error = force_error_at_samples(model.environment, truth, plan.data)
        return {"at the samples": error}
    if "true" not in fields:
        return None
    regions = default_regions(plan.data)
    return dict(force_errors(fields["learned"], fields["true"], regions))


def line_arrays(fitted: FittedRun, plan: FitPlan) -> dict[str, np.ndarray]:
    """The force along lines through data that are not planar."""
    model: Any = fitted.model
    profile = plan.summary.profile
    axes = range(plan.data.dim) if profile is None else profile.along
    arrays = {}
    for axis in axes:
        line = force_line(
            model.environment,
            plan.data,
            axis,
            posterior=fitted.posterior,
            truth=true_environment(plan),
        )
        for name in ("places", "force", "sd", "true"):
            if (values := getattr(line, name)) is not None:
                arrays[f"line/{plan.data.channels[axis]}/{name}"] = values
    return arrays


def field_arrays(fields: dict[str, FieldMap]) -> dict[str, np.ndarray]:
    """Planar fields as `results.npz` holds them."""
    learned = fields["learned"]
    return {
        "field/x": learned.x,
        "field/y": learned.y,
        "field/distance": learned.distance,
        **{f"field/{name}": field.force for name, field in fields.items()},
    }
