"""`pinav evaluate`: where the models of a run can be trusted.

Rollouts over time, from the data given and from clean starts that no fit has seen;
force by region; bands; residuals; learned constants.
"""

from pathlib import Path
from typing import Any

from pinav.commands.cells import as_cell
from pinav.commands.command import CommandResult
from pinav.commands.evaluate.judge import conformal, judge_fit
from pinav.commands.evaluate.setting import (
    Prediction,
    Setting,
    force_fields,
    prediction,
    read_data,
    starts_are_estimated,
    true_scenario,
)
from pinav.commands.evaluate.settings import EvaluateOptions
from pinav.commands.evaluate.tables import tables
from pinav.commands.fitted_run import FittedRun
from pinav.commands.held_out import held_out
from pinav.dynamics import AbstractDynamics, Outcome, Swimmer
from pinav.evaluation import (
    START_SAMPLES,
    Regions,
    default_regions,
    error_curve,
    force_agreement,
    position_errors,
    score,
    summarise,
)
from pinav.report.text import as_text
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories

EXTENSION = 2.0
"""How many training horizons clean held-out rollouts last."""


def evaluate(
    run: Path,
    data: Path,
    *,
    calibration: Path | None = None,
    regions: Regions | None = None,
) -> dict[str, Any]:
    """Score every model of the run on the trajectories of a file.

    Writes `evaluation.json`, `evaluation.csv` and `evaluation.npz` into the run.

    Args:
        run: folder of a finished run.
        data: trajectories to score, which no model was fitted to.
        calibration: further trajectories, from which conformal bands are calibrated.
        regions: what counts as visited; chosen from the training data unless given.

    Raises:
        InputError: the run holds no model, or a file cannot be read.
    """
    subject = FittedRun.open(run)
    folder = subject.folder
    trajectories = read_data(data, subject)
    setting = Setting(
        subject,
        trajectories,
        true_scenario(trajectories, subject),
        default_regions(subject.data) if regions is None else regions,
        starts_are_estimated(subject, trajectories),
    )
    metrics, arrays = _header(setting, data), {}
    clean = _clean(setting)
    for name, model in (subject.models | _baseline(subject)).items():
        _score_model(name, model, setting, clean, (metrics, arrays))
    judge_fit(setting, folder, clean, (metrics, arrays))
    if calibration is not None:
        metrics["calibration"] = conformal(setting, calibration)
    folder.write_json("evaluation.json", metrics)
    folder.write_arrays("evaluation.npz", arrays)
    _write_csv(folder, metrics)
    return metrics


def _baseline(subject: FittedRun) -> dict[str, AbstractDynamics]:
    """The known physics alone, as the least that a model must beat."""
    return {BASELINE: subject.system.swimmer}


BASELINE = "physics-only"
"""What the tables call it."""


def _header(setting: Setting, data: Path) -> dict[str, Any]:
    subject = setting.subject
    unit = subject.data.units[subject.data.channels[0]]
    return {
        "data": data.name,
        "trajectories": len(setting.data),
        "starts": (
            f"estimated from the first {START_SAMPLES} samples with the model fixed; "
            "only the samples after them are scored"
            if setting.estimate
            else "the first sample of each trajectory"
        ),
        "regions": setting.regions.definition(unit),
        "domain": setting.domain,
        "horizon": subject.horizon,
        "rmse": {},
        "rollouts": {},
        "force": {},
    }


def _clean(setting: Setting) -> Trajectories | None:
    """Held-out trajectories of the truth, beyond the training horizon."""
    if setting.truth is None:
        return None
    horizon = setting.subject.horizon
    return held_out(setting.truth, until=EXTENSION * horizon)


def _score_model(name, model, setting: Setting, clean, results) -> None:
    """Rollouts and force of one model."""
    metrics, arrays = results
    own = prediction(model, setting.data, estimate=setting.estimate)
    scores = score(own.ys, own.outcomes, own.observed).by_name()
    diverged = sum(outcome is not Outcome.SUCCESS for outcome in own.outcomes)
    metrics["rmse"][name] = {k: as_cell(v) for k, v in scores.items()} | {
        "diverged": diverged
    }
    sources = {"data": own}
    if clean is not None:
        sources["clean starts"] = prediction(model, clean, estimate=False)
    metrics["rollouts"][name] = {
        source: _rollouts(found, setting, arrays, f"curve/{name}/{source}")
        for source, found in sources.items()
    }
    if isinstance(model, Swimmer) and setting.truth is not None:
        fields = force_fields(model, setting)
        found = force_agreement(*fields, setting.regions)
        metrics["force"][name] = {
            region: {
                "error": as_cell(a.error),
                "cosine": as_cell(a.cosine),
                "points": a.points,
            }
            for region, a in found.items()
        }


def _rollouts(found: Prediction, setting: Setting, arrays, key: str):
    """Quantiles within the training horizon and beyond it; the curve into arrays."""
    errors = position_errors(found.ys, found.observed, domain=setting.domain)
    curve = error_curve(errors)
    for part in ("elapsed", "median", "high", "diverged"):
        arrays[f"{key}/{part}"] = getattr(curve, part)
    horizon = setting.subject.horizon * (1 + 1e-9)
    parts = {
        "within the training horizon": summarise(errors, until=horizon),
        "beyond it": summarise(errors, after=horizon),
    }
    return {
        part: {name: as_cell(value) for name, value in vars(summary).items()}
        for part, summary in parts.items()
        if summary.trajectories
    }


def _write_csv(folder: RunFolder, metrics: dict[str, Any]) -> None:
    """Every number of the tables in one long table."""
    rows: list[tuple] = []

    def walk(content: Any, path: tuple[str, ...]) -> None:
        if isinstance(content, dict | list):
            items = content.items() if isinstance(content, dict) else enumerate(content)
            for key, value in items:
                walk(value, (*path, str(key)))
        else:
            rows.append(("/".join(path), "" if content is None else content))

    walk(metrics, ())
    folder.write_table("evaluation.csv", ("quantity", "value"), rows)


def text(metrics: dict[str, Any]) -> str:
    """The metrics for a terminal."""
    return "\n\n".join(as_text(table) for table in tables(metrics))


def run(options: EvaluateOptions) -> CommandResult:
    """Evaluate as the command line does."""
    regions = None if options.regions is None else Regions(*options.regions)
    metrics = evaluate(
        options.run, options.data, calibration=options.calibrate, regions=regions
    )
    return CommandResult(metrics, text(metrics), RunFolder.open(options.run))
