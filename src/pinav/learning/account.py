"""The account of a fit: its errors, force, structure and remarks, as `Findings`."""

from typing import Any

import numpy as np

from pinav.evaluation import (
    FieldMap,
    ForceLine,
    default_regions,
    field_map,
    force_error_at_samples,
    force_errors,
    force_line,
    predict,
    restart_errors,
    score,
)
from pinav.fitting.environments.choice import KnownSwimmer
from pinav.forces import AbstractForce
from pinav.identification import needs_kalman_filter
from pinav.learning.findings import Findings, ForceMaps, Rollouts
from pinav.learning.learned import Learned
from pinav.learning.plan import FitPlan
from pinav.learning.recipes import name_of
from pinav.learning.remarks import (
    assumed_potential,
    confirm_outcome,
    likely_cause,
    narrow_prior,
    outcome_remarks,
    simpler_model,
)
from pinav.learning.structure import found_structure
from pinav.learning.thermal import thermal_remarks
from pinav.recordings.conventions import remarks
from pinav.scenarios import source_system


def account(plan: FitPlan, fit: Learned) -> Findings:
    """What a fit has to say: rollouts, errors, the force, and remarks.

    Args:
        plan: of the fit.
        fit: its result.
    """
    data, model, evidence = plan.data, fit.model, fit.evidence
    starts = None if evidence is None else evidence.states[:, 0]
    predictions, outcomes = predict(model, data, starts=starts)
    rmse = score(predictions, outcomes, data).by_name()
    maps = lines = None
    if isinstance(model, KnownSwimmer):
        maps = _force_maps(fit, plan) if data.dim == 2 else None
        lines = _force_lines(fit, plan) if data.dim != 2 else None
    losses = fit.losses
    if evidence is None:
        assert losses is not None  # there is no third kind of recipe
        loss = float(losses.values[0][-1])
        outcome = confirm_outcome(losses.outcomes[0], loss, data, rmse)
        sentences = (
            *outcome_remarks(outcome),
            *likely_cause(data, model, outcome, rmse),
            *simpler_model(plan, outcome, rmse),
        )
    else:
        outcome, chosen = evidence.outcome, evidence.hyperparameters
        search = evidence.structure
        sentences = (
            *outcome_remarks(outcome),
            *filter(None, [evidence.goodness]),
            *narrow_prior(model, chosen),
            *assumed_potential(plan, model, search.rotation if search else np.nan),
            *thermal_remarks(plan.thermal, data),
        )
    commanded = needs_kalman_filter(plan.system)
    return Findings(
        model=fit.choice.name,
        recipe=name_of(plan.recipe),
        outcome=outcome,
        rmse=rmse,
        constants=fit.constants,
        remarks=(*sentences, *remarks(data)),
        units=dict(sorted(fit.units.items())),
        rollouts=Rollouts(
            data.channels,
            data.times,
            data.states,
            data.observed,
            predictions,
            tuple(map(int, data.lengths)),
        ),
        force_error=_force_error(fit, maps, plan),
        hyperparameters=None if evidence is None else evidence.hyperparameters,
        iterations=None if evidence is None else evidence.iterations,
        support=None if evidence is None else evidence.support,
        losses=losses,
        restarts=restart_errors(model, data) if commanded else None,
        structure=found_structure(fit),
        thermal=fit.thermal,
        force=maps,
        lines=lines,
    )


def _force_maps(fit: Learned, plan: FitPlan) -> ForceMaps:
    """The learned force around planar data, and the true one where it is known."""
    model: Any = fit.model
    learned = field_map(model.environment, plan.data)
    truth = _true_environment(plan)
    return ForceMaps(
        FieldMap(
            learned.x,
            learned.y,
            learned.force,
            learned.distance,
            default_regions(plan.data),
        ),
        sd=None if fit.posterior is None else fit.force_sd(learned),
        true=None if truth is None else field_map(truth, plan.data).force,
    )


def _true_environment(plan: FitPlan) -> AbstractForce | None:
    """The environment of the system from which the data come, where it is known."""
    source = source_system(plan.data.provenance)
    return None if source is None else source.environment


def _force_error(
    fit: Learned, maps: ForceMaps | None, plan: FitPlan
) -> dict[str, float] | None:
    """Errors of the force by region, where its truth is known."""
    truth = _true_environment(plan)
    if truth is None or not isinstance(fit.model, KnownSwimmer):
        return None
    if maps is None or maps.truth is None:
        error = force_error_at_samples(fit.model.environment, truth, plan.data)
        return {"at the samples": error}
    return dict(force_errors(maps.learned, maps.truth, maps.learned.regions))


def _force_lines(fit: Learned, plan: FitPlan) -> dict[str, ForceLine]:
    """The force along lines through data that are not planar."""
    model: Any = fit.model
    profile = plan.summary.profile
    axes = range(plan.data.dim) if profile is None else profile.along
    truth = _true_environment(plan)
    return {
        plan.data.channels[axis]: force_line(
            model.environment,
            plan.data,
            axis,
            posterior=fit.posterior,
            truth=truth,
        )
        for axis in axes
    }
