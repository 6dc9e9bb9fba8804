"""`pinav fit`: one model fitted to given trajectories."""

import hashlib
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import msgspec
import numpy as np

from pinav.errors import InputError
from pinav.evaluation import Score, predict, score
from pinav.fitting import (
    Fit,
    FitOutcome,
    TrajectoryLoss,
    curriculum,
    paper_recipe,
)
from pinav.fitting import fit as fit_trajectories
from pinav.forces import LinearDrag
from pinav.jobs.models import (
    CONSTANTS,
    build_model,
    data_moments,
    fit_model,
    fit_trainable,
    known_physics,
)
from pinav.jobs.progress import FitReporter
from pinav.jobs.settings import FitSettings
from pinav.jobs.table2 import number
from pinav.runs import RunFolder
from pinav.solvers import FixedStep
from pinav.trajectories import Trajectories
from pinav.trajectory_files import save

MODEL_FILE = "model.eqx"


def check(settings: FitSettings, data: Trajectories) -> None:
    """Refuse data or settings before a run folder is made.

    Raises:
        InputError: the objective cannot use the data, no physics is named, or it is
            not of the kind that is fitted.
    """
    TrajectoryLoss().check(data)
    known = known_physics(settings.physics, data)
    drag = known.swimmer.drag
    if "damping" in settings.learn and not isinstance(drag, LinearDrag):
        raise InputError(
            f"--learn damping: scenario {known.name} has no such constant: its drag is "
            f"{type(drag).__name__}; drop it"
        )
    if len(known.channels) != len(data.channels):
        raise InputError(
            f"data: expected the channels {', '.join(known.channels)} of scenario "
            f"{known.name}, got {', '.join(data.channels)}"
        )


def fingerprint(data: Trajectories) -> str:
    """A short hash of the numbers that are fitted."""
    digest = hashlib.sha256()
    for array in (data.times, data.states, data.observed):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]


def fit(settings: FitSettings, data: Trajectories, folder: RunFolder) -> dict[str, Any]:
    """Fit, score and write the results; what the folder holds is not done again.

    Returns:
        The content of `metrics.json`.

    Raises:
        FitError: the fit diverged.
    """
    known = known_physics(settings.physics, data)
    if not folder.has("data.npz"):
        save(data, folder.path / "data.npz")
    if not folder.has(MODEL_FILE):
        _write_fit(
            settings, known.name, data, _fit(settings, known, data, folder), folder
        )
    model = folder.read_model(MODEL_FILE, build_model)
    predictions, outcomes = predict(model, data)
    result = score(predictions, outcomes, data)
    losses = folder.read_arrays("losses-model.npz")["losses"][0]
    metrics = {
        "model": settings.model,
        "loss": {"start": float(losses[0]), "end": float(losses[-1])},
        "rmse": score_metrics(result),
        "learned": {name: float(CONSTANTS[name](model)) for name in settings.learn},
    }
    folder.write_arrays(
        "results.npz",
        {
            "times": data.times,
            "truth": data.states,
            "observed": data.observed,
            "ys": predictions,
        },
    )
    folder.write_json("metrics.json", metrics)
    return metrics


def text(metrics: dict[str, Any]) -> str:
    """The metrics for a terminal."""
    rmse = ", ".join(f"{k} {number(v)}" for k, v in metrics["rmse"].items())
    loss = metrics["loss"]
    lines = [f"loss: {loss['start']:.3g} -> {loss['end']:.3g}", f"RMSE: {rmse}"]
    lines += [f"{name}: {value:.6g}" for name, value in metrics["learned"].items()]
    return "\n".join(lines)


def write_losses(name: str, fits: Sequence[Fit], folder: RunFolder) -> None:
    """Write the loss curves of fits that share a recipe to `losses-NAME.npz`."""
    folder.write_arrays(
        f"losses-{name}.npz",
        {
            "losses": np.stack([fit.losses for fit in fits]),
            "phase_starts": np.array([start for _, start in fits[0].phases]),
            "phase_names": np.array([phase for phase, _ in fits[0].phases]),
            "diverged": np.array([f.outcome is FitOutcome.DIVERGED for f in fits]),
        },
    )


def score_metrics(result: Score) -> dict[str, float]:
    """A score by the names of its columns."""
    by_channel = dict(zip(result.channels, map(float, result.rmse), strict=True))
    return by_channel | {"total": result.total, "position": result.position}


def _fit(settings, known, data, folder) -> Fit:
    paper = settings.recipe == "paper"
    recipe = (
        paper_recipe(settings.adam_steps, settings.lbfgs_steps)
        if paper
        else curriculum(data, max_steps=settings.max_steps)
    )
    with FitReporter(folder, settings.model) as report:
        return fit_trajectories(
            fit_model(settings, known.swimmer, data_moments(data)),
            data,
            recipe,
            trainable=fit_trainable(settings),
            objective=TrajectoryLoss(FixedStep(substeps=1 if paper else 2)),
            dtype=_dtype(settings),
            checkpoint=folder.checkpoint(settings.model),
            on_chunk=report,
        )


def _dtype(settings: FitSettings) -> type:
    """The paper's recipe is float32; Gauss-Newton wants float64."""
    return jnp.float32 if settings.recipe == "paper" else jnp.float64


def _write_fit(settings, physics, data, fit: Fit, folder: RunFolder) -> None:
    write_losses("model", [fit], folder)
    header = {
        "kind": "fit",
        "settings": msgspec.to_builtins(settings),
        "physics": physics,
        "data": data_moments(data),
        "dtype": jnp.dtype(_dtype(settings)).name,
    }
    folder.write_model(MODEL_FILE, header, fit.model)
