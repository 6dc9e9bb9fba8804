"""`pinav fit`: one model of the unknown, fitted to given data."""

import dataclasses
from typing import Any

import msgspec
import numpy as np

from pinav.commands.cells import EstimateRow
from pinav.commands.command import CommandResult
from pinav.commands.data_file import read_data
from pinav.commands.evidence_file import (
    MODEL_FILE,
    POSTERIOR_FILE,
    StructureSearch,
)
from pinav.commands.fit import FIT
from pinav.commands.fit.fields import (
    error_of_force,
    field_arrays,
    force_fields,
    line_arrays,
)
from pinav.commands.fit.metrics import FitMetrics, Loss, RestartRow
from pinav.commands.fit.plan import FitPlan, plan_fit
from pinav.commands.fit.remarks import (
    assumed_potential,
    confirm_outcome,
    likely_cause,
    narrow_prior,
    outcome_remarks,
    simpler_model,
)
from pinav.commands.fit.settings import EVIDENCE_RECIPES, FitOptions
from pinav.commands.fit.structure import profile_arrays, structure_row
from pinav.commands.fit.thermal import fit_thermal, read_checks, thermal_remarks
from pinav.commands.fitted_run import (
    FittedRun,
    ModelHeader,
    save_data,
    write_fit,
    write_model,
    write_teacher,
)
from pinav.commands.many_files import run_files
from pinav.commands.matching import matching, read_losses, write_losses
from pinav.commands.progress import BayesReporter, FitReporter, RoundReporter
from pinav.commands.recording_settings import RecordingSettings
from pinav.commands.settings import Settings
from pinav.commands.start import fingerprint, start_run
from pinav.commands.system_choice import (
    choose_system,
    write_system_of,
)
from pinav.errors import FitError
from pinav.evaluation import (
    FieldMap,
    predict,
    restart_errors,
    score,
)
from pinav.fitting import (
    EvidenceFit,
    Outcome,
    fit_bayes,
    fit_structured,
    is_network,
    is_worth_a_search,
    may_turn,
)
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.choice import MIXTURE, KnownSwimmer
from pinav.fitting.evidence.model_evidence import model_evidence
from pinav.forces import AbstractForce, as_learned_force
from pinav.identification import fit_commanded, needs_kalman_filter
from pinav.identification.parameters import BLOCK_NOISE
from pinav.recordings.conventions import remarks
from pinav.runs import RunFolder

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
            fields = force_fields(fitted.model, plan)
            arrays |= field_arrays(fields)
            if fitted.posterior is not None:
                arrays["field/sd"] = fitted.force_sd(fields["learned"])
        else:
            arrays |= line_arrays(fitted, plan)
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
        result, support = _fit_commanded(plan, model.environment, folder)
        write_fit(folder, header, result, plan.data, support=support)
        return
    weighs = plan.weigh_rotation and may_turn(model)
    searches = plan.settings.structure == "search" and (
        weighs or is_worth_a_search(model, plan.data)
    )
    with BayesReporter(folder, plan.choice.name) as report:
        options = {
            "learn": plan.choice.constants,
            "noise": plan.settings.noise,
            "max_iterations": plan.settings.max_steps,
            "on_step": report,
            "throw": False,
        }
        if searches:
            structured = fit_structured(
                model, plan.data, weigh_rotation=plan.weigh_rotation, **options
            )
            result, teacher = structured.fit, structured.teacher
            finding = StructureSearch(structured.gain, structured.rotation)
            if is_network(model) and teacher is None:
                finding = None  # the kernels that were searched diverged
        else:
            result, teacher = fit_bayes(model, plan.data, **options), None
            finding = None
    if result.outcome is Outcome.DIVERGED:
        force = as_learned_force(model.environment)
        gradient = force is not None and force.is_conservative
        raise FitError(DIVERGED + (NO_GRADIENT if gradient else ""))
    learned = as_learned_force(result.model.environment)
    if learned is not None and learned.helmholtz is not None:
        choice = msgspec.structs.replace(plan.choice, name=MIXTURE)
        header = msgspec.structs.replace(header, choice=choice)
    if teacher is not None and finding is not None:
        write_teacher(folder, header, teacher, plan.data, finding)
    write_fit(folder, header, result, plan.data, finding)


def _fit_commanded(
    plan: FitPlan, environment: AbstractForce, folder: RunFolder
) -> tuple[EvidenceFit, float | None]:
    """Fit a field beside commands and a wandering velocity; its evidence over none."""
    field, support = as_learned_force(environment), None
    with RoundReporter(folder, plan.choice.name) as report:

        def note(done: int, likelihood: float) -> None:
            report((done, likelihood))

        result = fit_commanded(plan.system, plan.data, field, on_round=note)
        if field is not None:
            report.label = "without a field"
            alone = fit_commanded(plan.system, plan.data, None, on_round=note)
            support = _evidence(result) - _evidence(alone)
    # The residuals are whitened, so that their noise is 1; a run keeps the system's,
    # or where that states none what the fit found for the mean of a block.
    noise = plan.system.observation.noise
    if noise == 0:
        noise = result.constants[BLOCK_NOISE].value
    chosen = dataclasses.replace(result.hyperparameters, noise=noise)
    return dataclasses.replace(result, hyperparameters=chosen), support


def _evidence(fit: EvidenceFit) -> float:
    return model_evidence(fit.linear, fit.hyperparameters).log_evidence


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
        "force_error": error_of_force(fitted.model, fields, plan),
        "units": dict(plan.data.units),
    }
    if evidence is None:
        losses = read_losses("model", fitted.folder)
        curve = losses.values[0]
        outcome = confirm_outcome(losses.outcomes[0], float(curve[-1]), plan.data, rmse)
        return FitMetrics(
            outcome=outcome,
            remarks=(
                *outcome_remarks(outcome),
                *likely_cause(plan.data, fitted.model, outcome, rmse),
                *simpler_model(plan, outcome, rmse),
                *remarks(plan.data),
            ),
            loss=Loss(float(curve[0]), float(curve[-1])),
            **common,
        )
    search = evidence.structure or StructureSearch(np.nan, np.nan)
    return FitMetrics(
        outcome=evidence.outcome,
        remarks=(
            *outcome_remarks(evidence.outcome),
            *filter(None, [evidence.goodness]),
            *narrow_prior(fitted.model, evidence.hyperparameters),
            *assumed_potential(plan, fitted.model, search.rotation),
            *thermal_remarks(plan),
            *remarks(plan.data),
        ),
        iterations=evidence.iterations,
        noise=evidence.hyperparameters.noise,
        amplitude=evidence.hyperparameters.amplitude,
        log_evidence=evidence.hyperparameters.log_evidence,
        structure=structure_row(fitted),
        support=evidence.support,
        thermal=read_checks(fitted.folder),
        **common,
    )
