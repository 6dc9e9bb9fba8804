"""The account of a fit: errors, force, structure, and remarks with remedies."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav import evaluation
from pinav.dynamics import Swimmer
from pinav.fitting import (
    Outcome,
    Posterior,
    confirm,
    derive,
    diagnose,
    is_worth_a_search,
    simpler_models,
)
from pinav.fitting.checks.departures import Contradiction, weigh_departures
from pinav.fitting.checks.residuals import copied_tracks, weigh_outlier
from pinav.fitting.environments.summary import MIXTURE, PROFILE, KnownSwimmer
from pinav.fitting.evidence.evidence import Hyperparameters
from pinav.fitting.evidence.hyperparameter_uncertainty import is_confined
from pinav.forces import (
    AbstractProfileTerm,
    AbstractTerm,
    as_learned_force,
    split_structure,
)
from pinav.identification import needs_kalman_filter
from pinav.learning import findings
from pinav.learning.evidence import with_unit
from pinav.learning.learned import Learned
from pinav.learning.plan import FitPlan
from pinav.learning.recipes import Bayes, name_of
from pinav.learning.thermal import thermal_remarks
from pinav.learning.verdict import judge
from pinav.recordings.conventions import remarks
from pinav.scenarios import source_system
from pinav.trajectories import Trajectories, with_velocities

POINTS = 121
"""Points of a profile."""


def found_structure(run: Learned) -> findings.FoundStructure | None:
    """The structure that a fit, or its teacher, found; None without a search."""
    kernels = run if run.teacher is None else run.teacher
    evidence, posterior = kernels.evidence, kernels.posterior
    if evidence is None or posterior is None or evidence.structure is None:
        return None
    model: Any = kernels.model
    force, search = model.environment, evidence.structure
    terms = split_structure(force)[0] if hasattr(force, "terms") else ()
    return findings.FoundStructure(
        tuple(
            _found_term(term, index, posterior, kernels)
            for index, term in enumerate(terms)
        ),
        search.gain if np.isfinite(search.gain) else None,
        search.rotation if np.isfinite(search.rotation) else None,
        turns=kernels.choice.name == MIXTURE,
        sought=is_worth_a_search(model, kernels.data),
        of_teacher=run.teacher is not None,
        tried=search.tried,
    )


def _found_term(
    term: AbstractTerm, index: int, posterior: Posterior, run: Learned
) -> findings.FoundTerm:
    has_profile = isinstance(term, AbstractProfileTerm)
    numbers = derive(posterior, lambda model: _numbers(model, index))
    pairs = zip(numbers, term.dimensions, strict=True)
    return findings.FoundTerm(
        term.kind,
        term.latex,
        tuple(with_unit(*pair, run.system) for pair in pairs),
        _found_law(term, posterior, index, run) if has_profile else None,
        _profile(term, posterior, index, run.data) if has_profile else None,
    )


def _numbers(model: Any, index: int) -> Float[Array, " number"]:
    term = model.environment.terms[index]
    leaves = term.placement
    return jnp.concatenate([jnp.zeros(0), *(jnp.ravel(leaf) for leaf in leaves)])


def _found_law(
    term: AbstractProfileTerm, posterior: Posterior, index: int, run: Learned
) -> findings.FoundLaw | None:
    law = term.law
    if law is None:
        return None

    def constants(model: Any) -> Float[Array, " constant"]:
        one = model.environment.terms[index]
        values = one.law.constants(one.offset).values()
        return jnp.stack([one.weights[0], *values])

    names = ("height", *law.constants())
    dimensions = (law.family.amplitude.unit, *law.dimensions)
    rows = zip(names, derive(posterior, constants), dimensions, strict=True)
    estimates = {name: with_unit(one, unit, run.system) for name, one, unit in rows}
    return findings.FoundLaw(law.name, law.latex, estimates)


def _profile(
    term: AbstractProfileTerm, posterior: Posterior, index: int, data: Trajectories
) -> evaluation.ForceLine:
    """The profile over the coordinates that were observed, with its deviation."""
    samples = jnp.asarray(data.seen_positions)
    coordinates = np.asarray(jax.vmap(term.coordinates)(samples))
    places = np.linspace(
        0.0 if term.is_odd else coordinates.min(), coordinates.max(), POINTS
    )

    def profile(model: Any) -> Array:
        return jax.vmap(model.environment.terms[index].profile)(jnp.asarray(places))

    values = derive(posterior, profile)
    return evaluation.ForceLine(
        places + float(term.offset),
        np.array([one.value for one in values]),
        np.array([one.sd for one in values]),
    )


REMARKS = {
    str(Outcome.STALLED): (
        "The fit stopped before its steps became negligible. If the errors above are "
        "not at the level of the noise, raise --max-steps or choose another --model."
    ),
    str(Outcome.MISFIT): (
        "The fit has found its best parameters, and yet the residuals are no noise, "
        "or kernels had to be fitted to pieces of the trajectories, since no force "
        "followed them whole. The model is too small for these data (--width, or "
        "another --model, such as kernel-mixture for a force that rotates), or the "
        "known physics (--system) are wrong."
    ),
    str(Outcome.UNDER_RESOLVED): (
        "The kernels are coarser than what the data show, and finer ones would be too "
        "many: fit fewer or shorter trajectories, or a smaller region."
    ),
}
"""Sentences on how a fit ended, by the word of its outcome."""


def outcome_remarks(outcome: str) -> tuple[str, ...]:
    """The sentence on how a fit ended, where its word needs one."""
    return (REMARKS[outcome],) if outcome in REMARKS else ()


def narrow_prior(model: Any, chosen: Hyperparameters) -> tuple[str, ...]:
    """Remark on bands of a prior at the edge of its range; nothing elsewhere."""
    force = as_learned_force(model.environment)
    if force is None or not is_confined(force.prior(), chosen.shape):
        return ()
    return (
        "The prior of the force ended at the narrowest that its kernels allow: the "
        "bands leave other shapes of the force out and are too narrow. Give more "
        "trajectories through the places where the force acts.",
    )


ASSUMED_POTENTIAL = (
    "The force was assumed conservative; this was not tested. If it may have a "
    "rotational part, fit --model kernel-mixture (in space kernel-force), too, and "
    "compare the log evidence."
)
"""Remark on a default that nothing has tested."""


def assumed_potential(plan: FitPlan, model: Any, rotation: float) -> tuple[str, ...]:
    """Remark that the force was assumed conservative, where nothing tested it."""
    force = as_learned_force(model.environment)
    if force is None or not force.is_conservative or plan.data.dim < 2:
        return ()
    return (ASSUMED_POTENTIAL,) if plan.is_open and np.isnan(rotation) else ()


def confirm_outcome(
    outcome: str, loss: float, data: Trajectories, rmse: dict[str, float]
) -> str:
    """The word for how a fit ended, which its independent rollouts confirm."""
    if outcome != str(Outcome.CONVERGED):
        return outcome
    residual = float(np.sqrt(loss / data.num_observed))
    total, spread = rmse["total"], data.spread
    return str(confirm(Outcome.CONVERGED, residual, total, spread))


def likely_cause(
    data: Trajectories, model: Any, outcome: str, rmse: dict[str, float]
) -> tuple[str, ...]:
    """Why a fit that misses the data failed, where the data tell it."""
    close = rmse["total"] <= FAILED * data.spread
    if outcome == str(Outcome.CONVERGED) or close or not isinstance(model, Swimmer):
        return ()
    cause = diagnose(model, data)
    return () if cause is None else (f"The likely cause of the failure: {cause}.",)


FAILED = 1e-3
"""Error of rollouts, in units of the spread of the data, whose cause is looked for."""


def simpler_model(
    plan: FitPlan, outcome: str, rmse: dict[str, float]
) -> tuple[str, ...]:
    """Remark on a model far better than a fit that did not converge."""
    if outcome == str(Outcome.CONVERGED):
        return ()
    total = rmse["total"]
    for name, model in simpler_models(plan.system.swimmer, plan.data).items():
        simple = evaluation.score(
            *evaluation.predict(model, plan.data), plan.data
        ).total
        if FAR_BETTER * simple < total or not np.isfinite(total):
            return (
                f"The fit failed: its rollouts miss the data by {total:.2g}, those of "
                f"{name} by {simple:.2g}; choose --model kernel-potential or another "
                "--seed.",
            )
    return ()


FAR_BETTER = 3.0
"""Ratio of errors beyond which a simpler model is recommended."""


DECAYS = (
    "That the force decays beyond the data is stated ([unknown] decays), not learned: "
    "bands there are narrow for that reason alone."
)


def account(plan: FitPlan, fit: Learned) -> findings.Findings:
    """The account of a fit: rollouts, errors, the force, and remarks."""
    data, model, evidence = plan.data, fit.model, fit.evidence
    starts = None if evidence is None else evidence.states[:, 0]
    predictions, outcomes = evaluation.predict(model, data, starts=starts)
    rmse = evaluation.score(predictions, outcomes, data).by_name()
    maps, lines, force_error = _judge_force(fit, plan)
    losses, outcome = fit.losses, fit.ending
    if evidence is None:
        assert losses is not None  # there is no third kind of recipe
        loss = float(losses.values[0][-1])
        outcome = confirm_outcome(outcome, loss, data, rmse)
        sentences = (
            *outcome_remarks(outcome),
            *likely_cause(data, model, outcome, rmse),
            *simpler_model(plan, outcome, rmse),
        )
    else:
        chosen = evidence.hyperparameters
        search = evidence.structure
        sentences = (
            *outcome_remarks(outcome),
            *([evidence.goodness.statement] if evidence.goodness else []),
            *narrow_prior(model, chosen),
            *assumed_potential(plan, model, search.rotation if search else np.nan),
            *thermal_remarks(plan.thermal, data),
            *([DECAYS] if plan.system.decays else []),
        )
    commanded = needs_kalman_filter(plan.system)
    contradictions = weigh_contradictions(fit, plan)
    return findings.Findings(
        model=fit.choice.name,
        recipe=name_of(plan.recipe),
        outcome=outcome,
        verdict=judge(
            outcome,
            contradictions,
            # That of thermal motion is no length, and trapped particles stay close.
            None if plan.thermal else copied_tracks(data, fit.noise),
            support=None if evidence is None else evidence.support,
            is_adequate=_is_adequate(fit),
            has_bands=evidence is not None,
        ),
        rmse=rmse,
        constants=fit.constants,
        remarks=(*sentences, *remarks(data)),
        units=dict(sorted(fit.units.items())),
        rollouts=findings.Rollouts(
            data.channels,
            data.times,
            data.states,
            data.observed,
            predictions,
            tuple(map(int, data.lengths)),
        ),
        force_error=force_error,
        hyperparameters=None if evidence is None else evidence.hyperparameters,
        iterations=None if evidence is None else evidence.iterations,
        support=None if evidence is None else evidence.support,
        losses=losses,
        restarts=evaluation.restart_errors(model, data) if commanded else None,
        structure=found_structure(fit),
        thermal=fit.thermal,
        force=maps,
        lines=lines,
        contradictions=contradictions,
    )


def weigh_contradictions(fit: Learned, plan: FitPlan) -> tuple[Contradiction, ...]:
    """Departures from the stated physics, and outliers, by their evidence.

    Of a network they are weighed beside the kernels that taught it. None where the fit
    has no smoothed states, or commands of each track drive it.
    """
    kernels = fit if fit.teacher is None else fit.teacher
    evidence, model = kernels.evidence, kernels.model
    if evidence is None or evidence.goodness is None or plan.thermal is not None:
        return ()
    data = plan.data
    if isinstance(model, Swimmer):
        data = with_velocities(data)
    weighed = [weigh_outlier(evidence.states, data)]
    is_force = isinstance(model, KnownSwimmer)
    learned = as_learned_force(model.environment) if is_force else None
    if learned is not None and learned.is_linear and learned.is_static:
        recipe = plan.recipe
        noise = recipe.noise if isinstance(recipe, Bayes) else None
        weighed += weigh_departures(model, evidence.states, data, noise=noise)
    return tuple(sorted(weighed, key=lambda one: -one.gain))


def _is_adequate(fit: Learned) -> bool | None:
    if fit.thermal is not None:
        return fit.thermal.checks.is_adequate
    goodness = None if fit.evidence is None else fit.evidence.goodness
    return None if goodness is None else goodness.is_adequate


def _judge_force(
    fit: Learned, plan: FitPlan
) -> tuple[
    findings.ForceMaps | None,
    dict[str, evaluation.ForceLine] | None,
    dict[str, float] | None,
]:
    """Maps of a planar force, lines through another one, and its error."""
    model, data = fit.model, plan.data
    if not isinstance(model, KnownSwimmer):
        return None, None, None
    force: Any = model.environment
    source = source_system(data.provenance)
    truth = None if source is None else source.environment
    if data.dim == 2:
        learned = evaluation.field_map(force, data)
        sd = None if fit.posterior is None else fit.force_sd(learned)
        if truth is None:
            return findings.ForceMaps(learned, sd=sd), None, None
        true = evaluation.field_map(truth, data)
        error = evaluation.force_errors(learned, true, learned.regions)
        return findings.ForceMaps(learned, true, sd), None, error
    axes = force.along if plan.choice.name == PROFILE else range(data.dim)
    lines = {
        data.channels[axis]: evaluation.force_line(
            force, data, axis, posterior=fit.posterior, truth=truth
        )
        for axis in axes
    }
    if truth is None:
        return None, lines, None
    error = evaluation.force_error_at_samples(force, truth, data)
    return None, lines, {"at the samples": error}
