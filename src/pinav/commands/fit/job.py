"""`pinav fit`: one model of the unknown, fitted to given data."""

import dataclasses
from typing import Any

import msgspec
import numpy as np

from pinav.commands.cells import EstimateRow
from pinav.commands.command import CommandResult
from pinav.commands.data_file import read_data
from pinav.commands.fit import FIT
from pinav.commands.fit.metrics import FitMetrics, Loss, RestartRow
from pinav.commands.fit.plan import FitPlan, plan_fit
from pinav.commands.fit.settings import EVIDENCE_RECIPES, FitOptions
from pinav.commands.fit.structure import profile_arrays, structure_row
from pinav.commands.fit.thermal import fit_thermal, read_checks, thermal_remarks
from pinav.commands.fitted_run import (
    MODEL_FILE,
    POSTERIOR_FILE,
    FittedRun,
    ModelHeader,
    StructureSearch,
    save_data,
    write_fit,
    write_model,
)
from pinav.commands.many_files import run_files
from pinav.commands.matching import matching, read_losses, write_losses
from pinav.commands.progress import BayesReporter, FitReporter
from pinav.commands.recording_settings import RecordingSettings
from pinav.commands.settings import Settings
from pinav.commands.start import fingerprint, start_run
from pinav.commands.system_choice import (
    choose_system,
    write_system_of,
)
from pinav.dynamics import AbstractDynamics, Swimmer
from pinav.errors import FitError
from pinav.evaluation import (
    FieldMap,
    default_regions,
    field_map,
    force_error_at_samples,
    force_errors,
    force_line,
    predict,
    restart_errors,
    score,
)
from pinav.fitting import (
    EvidenceFit,
    Outcome,
    confirm,
    diagnose,
    fit_bayes,
    fit_structured,
    is_worth_a_search,
    simpler_models,
)
from pinav.fitting.environments.catalogue import (
    MIXTURE,
    KnownSwimmer,
    build,
    is_mixture,
)
from pinav.fitting.evidence.evidence import Hyperparameters
from pinav.fitting.evidence.hyperparameter_uncertainty import is_confined
from pinav.forces import AbstractForce, as_learned_force
from pinav.identification import fit_commanded, needs_kalman_filter
from pinav.identification.numbers import BLOCK_NOISE
from pinav.recordings.conventions import remarks
from pinav.runs import RunFolder
from pinav.scenarios import source_system
from pinav.trajectories import Trajectories

REMARKS = {
    str(Outcome.STALLED): (
        "The fit stalled before its steps stopped to matter. If the errors above are "
        "not at the level of the noise, raise --max-steps or choose another --model."
    ),
    str(Outcome.MISFIT): (
        "The fit has found its best parameters, and yet the residuals are no noise: "
        "the model is too small for these data (--width, or another --model), or the "
        "known physics (--system) are wrong."
    ),
    str(Outcome.UNDER_RESOLVED): (
        "The kernels are coarser than what the data show, and finer ones would be too "
        "many: fit fewer or shorter trajectories, or a smaller region."
    ),
}
"""Sentences on how a fit ended, by the word of its outcome."""

DIVERGED = (
    "the fit diverged: the states depart from the dynamics of the system; check its "
    "propulsion, drag and units (--system), or fit shorter trajectories"
)

NO_GRADIENT = (
    "; a force that turns, such as that of a vortex, is no gradient of a potential: "
    "choose --model kernel-mixture for it"
)


def run(options: FitOptions) -> CommandResult:
    """Fit as the command line does."""
    file, *others = options.data
    if others:
        return run_files(FIT, options)
    data = read_data(file, options.recording)
    system = choose_system(options.settings.system, data)
    plan = plan_fit(options.settings, system, data)
    identity = {"data": fingerprint(plan.data), "system": system.name}
    groups: list[Settings] = [plan.settings]
    if options.recording != RecordingSettings():
        groups.append(options.recording)
    folder = start_run(FIT, options, *groups, **identity)
    metrics = fit(plan, folder)
    return CommandResult(metrics, metrics.text(), folder)


def fit(plan: FitPlan, folder: RunFolder) -> FitMetrics:
    """Fit, score and write the results; what the folder holds is not done again.

    Raises:
        FitError: the fit diverged, or the data do not determine it.
    """
    save_data(folder, plan.data)
    write_system_of(folder, plan.system)
    by_evidence = plan.settings.recipe in EVIDENCE_RECIPES
    if not folder.has(MODEL_FILE) or (by_evidence and not folder.has(POSTERIOR_FILE)):
        (_infer if by_evidence else _match)(plan, folder)
    fitted = FittedRun.open(folder.path)
    starts = None if fitted.evidence is None else fitted.evidence.states[:, 0]
    predictions, outcomes = predict(fitted.model, plan.data, starts=starts)
    arrays = {
        "times": plan.data.times,
        "truth": plan.data.states,
        "observed": plan.data.observed,
        "ys": predictions,
    }
    fields: dict[str, FieldMap] = {}
    if isinstance(fitted.model, KnownSwimmer):
        if plan.data.dim == 2:
            fields = _fields(fitted.model, plan)
            arrays |= _field_arrays(fields)
            if fitted.posterior is not None:
                arrays["field/sd"] = fitted.force_sd(fields["learned"])
        else:
            arrays |= _line_arrays(fitted, plan)
        arrays |= profile_arrays(fitted)
    folder.write_arrays("results.npz", arrays)
    rmse = score(predictions, outcomes, plan.data).by_name()
    metrics = _metrics(plan, fitted, rmse, fields)
    if needs_kalman_filter(plan.system):
        restarts = RestartRow.of_errors(restart_errors(fitted.model, plan.data))
        metrics = msgspec.structs.replace(metrics, restarts=restarts)
    folder.write_metrics("metrics.json", metrics)
    return metrics


def _infer(plan: FitPlan, folder: RunFolder) -> None:
    """Fit by the evidence."""
    model: Any = build(plan.choice, plan.system.swimmer, plan.summary)
    header = ModelHeader(plan.choice, plan.summary)
    if plan.settings.recipe == "langevin":
        write_fit(folder, header, fit_thermal(plan, model, folder), plan.data)
        return
    if needs_kalman_filter(plan.system):
        write_fit(folder, header, _fit_commanded(plan, model.environment), plan.data)
        return
    search = plan.settings.structure == "search"
    searched = search and is_worth_a_search(model, plan.data)
    with BayesReporter(folder, plan.choice.name) as report:
        options = {
            "learn": plan.choice.constants,
            "noise": plan.settings.noise,
            "max_iterations": plan.settings.max_steps,
            "on_step": report,
            "throw": False,
        }
        if searched:
            weighed = {"weigh_rotation": plan.weigh_rotation}
            structured = fit_structured(model, plan.data, **options, **weighed)
            result = structured.fit
            finding = StructureSearch(structured.gain, structured.rotation)
        else:
            result, finding = fit_bayes(model, plan.data, **options), None
    if result.outcome is Outcome.DIVERGED:
        force = as_learned_force(model.environment)
        gradient = force is not None and force.is_conservative
        raise FitError(DIVERGED + (NO_GRADIENT if gradient else ""))
    if is_mixture(result.model.environment):
        choice = msgspec.structs.replace(plan.choice, name=MIXTURE)
        header = msgspec.structs.replace(header, choice=choice)
    write_fit(folder, header, result, plan.data, finding)


def _fit_commanded(plan: FitPlan, environment: AbstractForce) -> EvidenceFit:
    """Fit a field beside commands and a wandering velocity."""
    result = fit_commanded(plan.system, plan.data, as_learned_force(environment))
    # The residuals are whitened, so that their noise is 1; a run keeps the system's,
    # or where that states none what the fit found for the mean of a block.
    noise = plan.system.observation.noise
    if noise == 0:
        noise = result.constants[BLOCK_NOISE].value
    chosen = dataclasses.replace(result.hyperparameters, noise=noise)
    return dataclasses.replace(result, hyperparameters=chosen)


def _match(plan: FitPlan, folder: RunFolder) -> None:
    """Match the trajectories."""
    model = build(plan.choice, plan.system.swimmer, plan.summary)
    method = matching(plan.settings, plan.data, model)
    with FitReporter(folder, plan.choice.name) as report:
        (result,) = method.fit(
            [model],
            plan.data,
            trainable=plan.choice.trainable,
            checkpoint=folder.checkpoint(plan.choice.name),
            on_chunk=report,
        )
    if result.outcome is Outcome.DIVERGED:
        raise FitError(DIVERGED)
    write_losses("model", [result], folder)
    header = ModelHeader(plan.choice, plan.summary, method.precision)
    write_model(folder, header, result.model)


def _metrics(
    plan: FitPlan,
    fitted: FittedRun,
    rmse: dict[str, float],
    fields: dict[str, FieldMap],
) -> FitMetrics:
    evidence = fitted.evidence
    learned = {name: EstimateRow.of(one) for name, one in fitted.constants.items()}
    common = {
        "model": fitted.choice.name,
        "recipe": plan.settings.recipe,
        "rmse": rmse,
        "learned": learned,
        "force_error": _force_errors(fitted.model, fields, plan),
    }
    if evidence is None:
        losses = read_losses("model", fitted.folder)
        curve = losses.values[0]
        outcome = _confirm_outcome(
            losses.outcomes[0], float(curve[-1]), plan.data, rmse
        )
        return FitMetrics(
            outcome=outcome,
            remarks=(
                *_remarks(outcome),
                *_cause(plan.data, fitted.model, outcome, rmse),
                *_simpler(plan, outcome, rmse),
                *remarks(plan.data),
            ),
            loss=Loss(float(curve[0]), float(curve[-1])),
            **common,
        )
    return FitMetrics(
        outcome=evidence.outcome,
        remarks=(
            *_remarks(evidence.outcome),
            *filter(None, [evidence.goodness]),
            *narrow_prior(fitted.model, evidence.hyperparameters),
            *thermal_remarks(plan),
            *remarks(plan.data),
        ),
        iterations=evidence.iterations,
        noise=evidence.hyperparameters.noise,
        amplitude=evidence.hyperparameters.amplitude,
        log_evidence=evidence.hyperparameters.log_evidence,
        structure=structure_row(fitted),
        thermal=read_checks(fitted.folder),
        **common,
    )


def _remarks(outcome: str) -> tuple[str, ...]:
    return (REMARKS[outcome],) if outcome in REMARKS else ()


def narrow_prior(model: Any, chosen: Hyperparameters) -> tuple[str, ...]:
    """What a prior at the edge of its range means for the bands; nothing elsewhere."""
    force = as_learned_force(model.environment)
    if force is None or not is_confined(force.prior(), chosen.shape):
        return ()
    return (
        "The prior of the force ended at the narrowest that its kernels allow: the "
        "bands leave other shapes of the force out and are too narrow. Give more "
        "trajectories through the places where the force acts.",
    )


def _confirm_outcome(
    outcome: str, loss: float, data: Trajectories, rmse: dict[str, float]
) -> str:
    """The word for how a fit ended, which its independent rollouts confirm."""
    if outcome != str(Outcome.CONVERGED):
        return outcome
    residual = float(np.sqrt(loss / data.num_observed))
    total, spread = rmse["total"], _spread(data)
    return str(confirm(Outcome.CONVERGED, residual, total, spread))


def _cause(
    data: Trajectories, model: Any, outcome: str, rmse: dict[str, float]
) -> tuple[str, ...]:
    """Why a fit that misses the data failed, where the data tell it."""
    close = rmse["total"] <= FAILED * _spread(data)
    if outcome == str(Outcome.CONVERGED) or close or not isinstance(model, Swimmer):
        return ()
    cause = diagnose(model, data)
    return () if cause is None else (f"The likely cause of the failure: {cause}.",)


def _spread(data: Trajectories) -> float:
    return float(np.std(data.states[data.observed]))


FAILED = 1e-3
"""Error of rollouts, in units of the spread of the data, whose cause is looked for."""


def _simpler(plan: FitPlan, outcome: str, rmse: dict[str, float]) -> tuple[str, ...]:
    """What explains the data far better than a fit that did not converge."""
    if outcome == str(Outcome.CONVERGED):
        return ()
    total = rmse["total"]
    for name, model in simpler_models(plan.system.swimmer, plan.data).items():
        simple = score(*predict(model, plan.data), plan.data).total
        if FAR_BETTER * simple < total or not np.isfinite(total):
            return (
                f"The fit failed: its rollouts miss the data by {total:.2g}, those of "
                f"{name} by {simple:.2g}; choose --model kernel-potential or another "
                "--seed.",
            )
    return ()


FAR_BETTER = 3.0
"""Ratio of errors beyond which a simpler model is recommended."""


def _fields(model: KnownSwimmer, plan: FitPlan) -> dict[str, FieldMap]:
    """The learned force around the data, and the true one where it is known."""
    fields = {"learned": field_map(model.environment, plan.data)}
    truth = _true_environment(plan)
    if truth is not None:
        fields["true"] = field_map(truth, plan.data)
    return fields


def _true_environment(plan: FitPlan) -> AbstractForce | None:
    """That of the system from which the data come, where it is known."""
    source = source_system(plan.data.provenance)
    return None if source is None else source.environment


def _force_errors(
    model: AbstractDynamics, fields: dict[str, FieldMap], plan: FitPlan
) -> dict[str, float | None] | None:
    if plan.data.dim != 2 and isinstance(model, KnownSwimmer):
        truth = _true_environment(plan)
        if truth is None:
            return None
        error = force_error_at_samples(model.environment, truth, plan.data)
        return {"at the samples": error}
    if "true" not in fields:
        return None
    regions = default_regions(plan.data)
    return dict(force_errors(fields["learned"], fields["true"], regions))


def _line_arrays(fitted: FittedRun, plan: FitPlan) -> dict[str, np.ndarray]:
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
            truth=_true_environment(plan),
        )
        for name in ("places", "force", "sd", "true"):
            if (values := getattr(line, name)) is not None:
                arrays[f"line/{plan.data.channels[axis]}/{name}"] = values
    return arrays


def _field_arrays(fields: dict[str, FieldMap]) -> dict[str, np.ndarray]:
    learned = fields["learned"]
    return {
        "field/x": learned.x,
        "field/y": learned.y,
        "field/distance": learned.distance,
        **{f"field/{name}": field.force for name, field in fields.items()},
    }
