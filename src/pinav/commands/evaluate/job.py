"""`pinav evaluate`: scores that say where the models of a run can be trusted.

Rollouts over time, from the data given and from clean starts that no fit has seen;
force by region; bands; residuals; learned constants.
"""

from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np

from pinav.commands.cells import Cell, as_cell
from pinav.commands.command import CommandResult
from pinav.commands.evaluate.judge import (
    calibrate_band,
    coverage_rows,
    recovered_constants,
    residual_rows,
    residual_whiteness,
)
from pinav.commands.evaluate.metrics import EvaluationMetrics, ForceRow, RolloutRow
from pinav.commands.evaluate.setting import (
    Prediction,
    Setting,
    predict_rollouts,
    read_setting,
)
from pinav.commands.evaluate.settings import EvaluateOptions
from pinav.commands.evaluate.tables import tables
from pinav.commands.held_out import held_out
from pinav.commands.recording_settings import RecordingSettings
from pinav.dynamics import AbstractDynamics, Outcome, OverdampedSwimmer, Swimmer
from pinav.evaluation import (
    START_SAMPLES,
    Regions,
    error_curve,
    force_agreement,
    position_errors,
    score,
    summarise,
)
from pinav.learning.learned import Learned
from pinav.report import quantity
from pinav.report.text import as_text
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories

EVALUATION_FILE, ARRAYS_FILE = "evaluation.json", "evaluation.npz"

EXTENSION = 2.0
"""Training horizons that clean held-out rollouts last."""

BASELINE = "physics-only"
"""Name of the known physics alone in the tables."""

WITHIN = "within the training horizon"
"""Name of the part of a rollout that is as long as the training data."""

Arrays = dict[str, np.ndarray]


def evaluate(
    run: Path,
    data: Path,
    *,
    calibration: Path | None = None,
    regions: Regions | None = None,
    recording: RecordingSettings | None = None,
) -> EvaluationMetrics:
    """Score every model of the run on the trajectories of a file.

    Writes `evaluation.json`, `evaluation.csv` and `evaluation.npz` into the run.

    Args:
        run: folder of a finished run.
        data: trajectories to score: others than the run was fitted to, or the scores
            are said to be training errors.
        calibration: further trajectories, from which conformal bands are calibrated.
        regions: lengths of the regions; chosen from the training data unless given.
        recording: how the files are read where they are recordings.

    Raises:
        InputError: the run holds no model, a file cannot be read, or `calibration`
            holds training data.
    """
    recording = RecordingSettings() if recording is None else recording
    setting = read_setting(run, data, regions, recording)
    fitted, clean = setting.run, clean_trajectories(setting)
    models = fitted.models | _baseline(fitted)
    sources = {
        name: _predictions(model, setting, clean) for name, model in models.items()
    }
    rollouts, arrays = _rollouts(sources, setting)
    unit = fitted.data.units["x"]
    single = len(fitted.models) == 1
    whiteness = residual_whiteness(setting) if single else None
    if whiteness is not None:
        arrays["autocorrelation"] = whiteness.autocorrelation
        arrays["counts"] = np.array(whiteness.counts)
        arrays["channels"] = np.array(whiteness.channels)
    metrics = EvaluationMetrics(
        data=data.name,
        trajectories=len(setting.data),
        starts=(
            f"estimated from the first {START_SAMPLES} samples with the model fixed; "
            "only the samples after them are scored"
            if setting.estimate
            else "the first sample of each trajectory"
        ),
        regions=setting.regions.definition(unit),
        domain=setting.domain,
        horizon=fitted.horizon,
        rmse={name: _errors(source["data"]) for name, source in sources.items()},
        rollouts=rollouts,
        force=_forces(models, setting),
        num_training=fitted.shared_trajectories(setting.data),
        units=dict(fitted.data.units),
        whiteness=None if whiteness is None else residual_rows(whiteness),
        constants=recovered_constants(setting) if single else None,
        coverage=coverage_rows(setting, clean) if single else None,
        calibration=(
            None
            if calibration is None
            else calibrate_band(setting, calibration, recording)
        ),
        notes=(*setting.notes, *_worse_than_physics(rollouts, unit)),
    )
    _write(fitted.folder, metrics, arrays)
    return metrics


def _worse_than_physics(
    rollouts: Mapping[str, Mapping[str, Mapping[str, RolloutRow]]], unit: str
) -> list[str]:
    """A sentence for each model whose rollouts err more than the known physics."""

    def median(model: str) -> float:
        row = rollouts[model]["data"].get(WITHIN)
        value = np.nan if row is None else row.median
        return value if isinstance(value, float) else np.inf

    alone = median(BASELINE)
    return [
        f"The learned force makes rollouts worse: {model} errs by "
        f"{quantity(median(model), unit)} in the median, the known physics alone by "
        f"{quantity(alone, unit)}. Do not predict or steer with it: these data do not "
        "determine it, or another model suits it (pinav compare weighs several)."
        for model in rollouts
        if median(model) > WORSE * alone
    ]


WORSE = 1.1
"""Error relative to that of the known physics above which a warning is due."""


def _baseline(run: Learned) -> dict[str, AbstractDynamics]:
    """The known physics alone, as the least that a model must beat."""
    return {BASELINE: run.system.swimmer.without_environment()}


def clean_trajectories(setting: Setting) -> Trajectories | None:
    """Held-out trajectories of the truth, beyond the training horizon."""
    if setting.truth is None or setting.truth.rule is None:
        return None
    return held_out(setting.truth, until=EXTENSION * setting.run.horizon)


def _predictions(
    model: AbstractDynamics, setting: Setting, clean: Trajectories | None
) -> dict[str, Prediction]:
    """Rollouts of a model by the source of their starts."""
    sources = {"data": predict_rollouts(model, setting.data, estimate=setting.estimate)}
    if clean is not None:
        sources["clean starts"] = predict_rollouts(model, clean, estimate=False)
    return sources


def _errors(prediction: Prediction) -> dict[str, Cell]:
    """Root-mean-square errors by column, and the number that diverged."""
    scored = score(prediction.ys, prediction.outcomes, prediction.observed)
    diverged = sum(end is not Outcome.SUCCESS for end in prediction.outcomes)
    cells = {name: as_cell(value) for name, value in scored.by_name().items()}
    return cells | {"diverged": diverged}


def _rollouts(
    sources: Mapping[str, Mapping[str, Prediction]], setting: Setting
) -> tuple[dict[str, dict[str, dict[str, RolloutRow]]], Arrays]:
    """Errors within the training horizon and beyond it, and their curves over time."""
    rows, arrays = {}, {}
    for model, predictions in sources.items():
        rows[model] = {}
        for source, prediction in predictions.items():
            errors = position_errors(
                prediction.ys, prediction.observed, domain=setting.domain
            )
            arrays |= error_curve(errors).as_arrays(f"curve/{model}/{source}")
            horizon = setting.run.horizon * (1 + 1e-9)
            parts = {
                WITHIN: summarise(errors, until=horizon),
                "beyond it": summarise(errors, after=horizon),
            }
            rows[model][source] = {
                part: RolloutRow.of(summary)
                for part, summary in parts.items()
                if summary.trajectories
            }
    return rows, arrays


def _forces(
    models: Mapping[str, AbstractDynamics], setting: Setting
) -> dict[str, dict[str, ForceRow]]:
    """Agreement with the true force by region, of every model that has a force."""
    if setting.truth is None or not setting.planar:
        return {}
    rows = {}
    for name, model in models.items():
        if isinstance(model, Swimmer | OverdampedSwimmer):
            agreements = force_agreement(*setting.force_fields(model), setting.regions)
            rows[name] = {
                region: ForceRow(as_cell(a.error), as_cell(a.cosine), a.points)
                for region, a in agreements.items()
            }
    return rows


def _write(folder: RunFolder, metrics: EvaluationMetrics, arrays: Arrays) -> None:
    folder.write_arrays(ARRAYS_FILE, arrays)
    rows = _flat_rows(msgspec.to_builtins(metrics))
    folder.write_table("evaluation.csv", ("quantity", "value"), rows)
    folder.write_metrics(EVALUATION_FILE, metrics)


def _flat_rows(content: object, path: tuple[str, ...] = ()) -> list[tuple[str, Cell]]:
    """Every number of the tables as one long table."""
    if isinstance(content, dict | list | tuple):
        items = content.items() if isinstance(content, dict) else enumerate(content)
        parts = [_flat_rows(value, (*path, str(key))) for key, value in items]
        return [row for part in parts for row in part]
    value = content if isinstance(content, int | float | str) else ""
    return [("/".join(path), value)]


def text(metrics: EvaluationMetrics) -> str:
    """The metrics for a terminal."""
    lines = [metrics.purpose, *metrics.notes]
    return "\n\n".join([*(as_text(table) for table in tables(metrics)), *lines])


def run(options: EvaluateOptions) -> CommandResult:
    """Evaluate as the command line does."""
    regions = None if options.regions is None else Regions(*options.regions)
    metrics = evaluate(
        options.run,
        options.data,
        calibration=options.calibrate,
        regions=regions,
        recording=options.recording,
    )
    return CommandResult(metrics, text(metrics), RunFolder.open(options.run))
