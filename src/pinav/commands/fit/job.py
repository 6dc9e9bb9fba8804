"""`pinav fit`: one model fitted to given trajectories."""

from collections.abc import Sequence
from operator import attrgetter
from typing import Any

import msgspec
import numpy as np

from pinav.commands.command import CommandResult
from pinav.commands.fit import bayes as inference
from pinav.commands.fit.bayes import MODEL_FILE
from pinav.commands.fit.command import FIT
from pinav.commands.fit.matching import matching
from pinav.commands.fit.settings import FitOptions, FitSettings
from pinav.commands.models import (
    CONSTANTS,
    KnownSwimmer,
    build_model,
    data_summary,
    fit_model,
    fit_trainable,
    known_physics,
    mean_drag,
)
from pinav.commands.progress import FitReporter
from pinav.commands.reproduce.table2 import number
from pinav.commands.start import fingerprint, start_run
from pinav.dynamics import Swimmer
from pinav.errors import InputError
from pinav.evaluation import (
    FieldMap,
    Regions,
    Score,
    default_regions,
    field_map,
    force_errors,
    predict,
    score,
)
from pinav.fitting import Fit
from pinav.fitting import fit as fit_trajectories
from pinav.forces import LinearDrag
from pinav.runs import RunFolder
from pinav.scenarios import scenario
from pinav.systems import System
from pinav.trajectories import (
    Trajectories,
    is_trajectories,
    load,
    save,
    with_unobserved,
)


def prepared(settings: FitSettings, data: Trajectories) -> Trajectories:
    """The data as the fit needs them; refused before a run folder is made.

    Positions alone get velocities that nobody observed.

    Raises:
        InputError: the recipe cannot use the data, no physics is named, or it is
            not of the kind that is fitted.
    """
    known = known_physics(settings.physics, data)
    _check_dynamics(settings, known)
    drag = getattr(known.swimmer, "drag", None)
    if "damping" in settings.learn and not isinstance(drag, LinearDrag):
        raise InputError(
            f"--learn damping: scenario {known.name} has no such constant: its drag is "
            f"{'a mobility' if drag is None else type(drag).__name__}; drop it"
        )
    positions = _positions(known)
    if settings.method == "bayes":
        data = with_all_channels(data, known)
    if len(known.channels) != len(data.channels):
        raise InputError(
            f"data: expected the channels {', '.join(known.channels)} of scenario "
            f"{known.name}, got {', '.join(data.channels)}"
            + (
                "; --recipe bayes needs positions alone"
                if data.channels == positions
                else ""
            )
        )
    if settings.method not in BAYESIAN:
        _check_starts(data)
    return data


def with_all_channels(data: Trajectories, known: System) -> Trajectories:
    """The data; positions alone get velocities that nobody observed."""
    positions = _positions(known)
    if data.channels != positions:
        return data
    unseen = known.channels[len(positions) :]
    return with_unobserved(data, {name: known.units[name] for name in unseen})


def _positions(known: System) -> tuple[str, ...]:
    return known.position_channels


BAYESIAN = ("bayes", "langevin")
"""Recipes with a posterior."""


def _check_dynamics(settings: FitSettings, known: System) -> None:
    """The recipe and the model must suit the order of the dynamics."""
    inert = isinstance(known.swimmer, Swimmer)
    if settings.method == "langevin" and inert:
        raise InputError(
            f"--recipe langevin: expected physics without inertia, such as brownian, "
            f"got scenario {known.name}; choose --recipe bayes"
        )
    if "drag" in settings.learn:
        mean_drag(known.swimmer, {"mean": [0.0, 0.0], "dim": 2})
    if not inert and settings.model == "ude":
        raise InputError(
            f"--model ude: expected physics with inertia, got scenario {known.name}; "
            "choose a kernel or neural model"
        )


def fit(settings: FitSettings, data: Trajectories, folder: RunFolder) -> dict[str, Any]:
    """Fit, score and write the results; what the folder holds is not done again.

    Returns:
        The content of `metrics.json`.

    Raises:
        FitError: the fit diverged, or the data do not determine it.
    """
    known = known_physics(settings.physics, data)
    if not folder.has("data.npz"):
        save(data, folder.path / "data.npz")
    bayes = settings.method in BAYESIAN
    if not folder.has(MODEL_FILE):
        run = inference.infer if bayes else _match
        run(settings, known, data, folder)
    model = folder.read_model(MODEL_FILE, build_model)
    metrics: dict[str, Any] = {"model": settings.model, "recipe": settings.method}
    if bayes:
        metrics |= inference.metrics(folder)
    else:
        metrics |= _matched_metrics(settings, model, folder)
    predictions, outcomes = predict(
        model, data, starts=inference.starts(folder) if bayes else None
    )
    metrics["rmse"] = score_metrics(score(predictions, outcomes, data))
    arrays = {
        "times": data.times,
        "truth": data.states,
        "observed": data.observed,
        "ys": predictions,
    }
    if isinstance(model, KnownSwimmer):
        fields = _fields(model, data)
        metrics |= _force_errors(fields, default_regions(data))
        arrays |= _field_arrays(fields)
        if bayes:
            arrays["field/sd"] = inference.force_sd(settings, fields["learned"], folder)
    folder.write_arrays("results.npz", arrays)
    folder.write_json("metrics.json", metrics)
    return metrics


def _fields(model: KnownSwimmer, data: Trajectories) -> dict[str, FieldMap]:
    """The learned force around the data, and the true one where it is known."""
    fields = {"learned": field_map(model.environment, data)}
    if "scenario" in data.provenance:
        truth = scenario(data.provenance["scenario"]).true_swimmer
        fields["true"] = field_map(truth.environment, data)
    return fields


def _force_errors(fields: dict[str, FieldMap], regions: Regions) -> dict[str, Any]:
    if "true" not in fields:
        return {}
    return {"force_error": force_errors(fields["learned"], fields["true"], regions)}


def _field_arrays(fields: dict[str, FieldMap]) -> dict[str, np.ndarray]:
    learned = fields["learned"]
    return {
        "field/x": learned.x,
        "field/y": learned.y,
        "field/distance": learned.distance,
        **{f"field/{name}": field.force for name, field in fields.items()},
    }


def text(metrics: dict[str, Any]) -> str:
    """The metrics for a terminal."""
    rmse = ", ".join(f"{k} {number(v)}" for k, v in metrics["rmse"].items())
    if "loss" in metrics:
        loss = metrics["loss"]
        lines = [
            f"loss: {loss['start']:.3g} -> {loss['end']:.3g} ({metrics['outcome']})"
        ]
    else:
        lines = [
            f"noise: {metrics['noise']:.3g}, log evidence "
            f"{metrics['log_evidence']:.1f}, {metrics['iterations']} steps"
        ]
        if metrics["outcome"] == "under-resolved":
            lines.append(UNDER_RESOLVED)
    lines.append(f"RMSE: {rmse}")
    for name, learned in metrics["learned"].items():
        spread = "" if learned["sd"] is None else f" ± {learned['sd']:.2g} (sd)"
        lines.append(f"{name}: {learned['value']:.6g}{spread}")
    if "force_error" in metrics:
        errors = ", ".join(f"{k} {v:.2%}" for k, v in metrics["force_error"].items())
        lines.append(f"force error (truth of the scenario): {errors}")
    return "\n".join(lines)


UNDER_RESOLVED = (
    "the kernels are coarser than the data: finer ones would be too many; fit fewer or "
    "shorter trajectories, or a smaller region"
)
"""Printed where a fit ended on kernels that blur what the data show."""


def write_losses(name: str, fits: Sequence[Fit], folder: RunFolder) -> None:
    """Write the loss curves of fits that share a recipe to `losses-NAME.npz`."""
    folder.write_arrays(
        f"losses-{name}.npz",
        {
            "losses": np.stack([fit.losses for fit in fits]),
            "phase_starts": np.array([start for _, start in fits[0].phases]),
            "phase_names": np.array([phase for phase, _ in fits[0].phases]),
            "outcomes": np.array([str(fit.outcome) for fit in fits]),
        },
    )


def score_metrics(result: Score) -> dict[str, float]:
    """A score by the names of its columns, without what was never observed."""
    errors = zip(result.channels, map(float, result.rmse), strict=True)
    by_channel = {name: error for name, error in errors if not np.isnan(error)}
    return by_channel | {"total": result.total, "position": result.position}


def _check_starts(data: Trajectories) -> None:
    for index, first in enumerate(data.observed[:, 0]):
        if not first.all():
            raise InputError(
                f"trajectory {index}: its first sample must be fully observed, because "
                "the rollout starts there; drop the samples before it, or choose "
                "--recipe bayes"
            )


def _match(
    settings: FitSettings, known: System, data: Trajectories, folder: RunFolder
) -> None:
    """Match the trajectories; the model file is written last."""
    method, summary = matching(settings, data), data_summary(data)
    with FitReporter(folder, settings.model) as report:
        found = fit_trajectories(
            fit_model(settings, known.swimmer, summary),
            data,
            method.recipe,
            trainable=fit_trainable(settings),
            checkpoint=folder.checkpoint(settings.model),
            on_chunk=report,
            **method.options(),
        )
    write_losses("model", [found], folder)
    header = {
        "kind": "fit",
        "settings": msgspec.to_builtins(settings),
        "physics": known.name,
        "data": summary,
        "dtype": method.precision,
    }
    folder.write_model(MODEL_FILE, header, found.model)


def _matched_metrics(settings, model, folder: RunFolder) -> dict[str, Any]:
    stored = folder.read_arrays("losses-model.npz")
    losses = stored["losses"][0]
    constants = {name: attrgetter(CONSTANTS[name])(model) for name in settings.learn}
    return {
        "outcome": str(stored["outcomes"][0]),
        "loss": {"start": float(losses[0]), "end": float(losses[-1])},
        "learned": {
            name: {"value": float(value), "sd": None}
            for name, value in constants.items()
        },
    }


def run(options: FitOptions) -> CommandResult:
    """Fit as the command line does."""
    if is_trajectories(options.data):
        data = load(options.data)
    else:
        data = options.recording.read(options.data)
    data = prepared(options.settings, data)
    folder = start_run(FIT, options, options.settings, data=fingerprint(data))
    metrics = fit(options.settings, data, folder)
    return CommandResult(metrics, text(metrics), folder)
