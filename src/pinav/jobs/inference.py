"""The Bayesian fit of a run: model, posterior, and what the evidence chose."""

from typing import Any

import msgspec
import numpy as np

from pinav.evaluation import FieldMap
from pinav.fitting import BayesFit, KernelGrid, Posterior, fit_bayes, freed
from pinav.jobs.models import (
    CONSTANTS,
    build_model,
    data_summary,
    fit_constants,
    fit_model,
    fit_trainable,
)
from pinav.jobs.progress import BayesReporter
from pinav.jobs.settings import FitSettings
from pinav.runs import RunFolder
from pinav.scenarios import Scenario
from pinav.trajectories import Trajectories

MODEL_FILE, POSTERIOR_FILE = "model.eqx", "posterior.npz"


def infer(
    settings: FitSettings, known: Scenario, data: Trajectories, folder: RunFolder
) -> None:
    """Fit by the evidence; the model file is written last, when all else is there.

    Raises:
        FitError: the fit did not converge, or the data do not determine it.
    """
    summary = data_summary(data, KernelGrid())
    with BayesReporter(folder, settings.model) as report:
        found = fit_bayes(
            fit_model(settings, known.truth, summary),
            data,
            learn=fit_constants(settings),
            noise=settings.noise,
            max_iterations=settings.max_steps,
            on_step=report,
        )
    _write(settings, known, summary, found, folder)


def _write(settings, known, summary, found: BayesFit, folder: RunFolder) -> None:
    chosen = found.hyperparameters
    folder.write_arrays(
        POSTERIOR_FILE,
        {
            "mean": found.posterior.mean,
            "covariance": found.posterior.covariance,
            "shape": chosen.shape,
            "amplitude": np.array(chosen.amplitude),
            "noise": np.array(chosen.noise),
            "log_evidence": np.array(chosen.log_evidence),
            "iterations": np.array(found.iterations),
            "states": found.states,
            **_constants(settings, found),
        },
    )
    header = {
        "kind": "fit",
        "settings": msgspec.to_builtins(settings),
        "physics": known.name,
        "data": summary,
        "dtype": "float64",
    }
    folder.write_model(MODEL_FILE, header, found.model)


def _constants(settings, found: BayesFit) -> dict[str, np.ndarray]:
    """Value and standard deviation of each learned constant."""
    estimates = {name: found.constants[CONSTANTS[name]] for name in settings.learn}
    return {
        f"constant/{name}": np.array([estimate.value, estimate.sd])
        for name, estimate in estimates.items()
    }


def read_posterior(settings: FitSettings, folder: RunFolder) -> Posterior:
    """The posterior of a run of `infer`.

    Raises:
        InputError: a file of the run is missing or damaged.
    """
    model = folder.read_model(MODEL_FILE, build_model)
    stored = folder.read_arrays(POSTERIOR_FILE)
    free, _ = freed(model, fit_trainable(settings))
    return Posterior(free, stored["mean"], stored["covariance"])


def metrics(settings: FitSettings, folder: RunFolder) -> dict[str, Any]:
    """What the evidence chose, and the learned constants with their deviations."""
    stored = folder.read_arrays(POSTERIOR_FILE)
    return {
        "iterations": int(stored["iterations"]),
        "noise": float(stored["noise"]),
        "amplitude": float(stored["amplitude"]),
        "log_evidence": float(stored["log_evidence"]),
        "learned": {
            name: dict(
                zip(("value", "sd"), stored[f"constant/{name}"].tolist(), strict=True)
            )
            for name in settings.learn
        },
    }


def starts(folder: RunFolder) -> np.ndarray:
    """The estimated start of each trajectory of the fit."""
    return folder.read_arrays(POSTERIOR_FILE)["states"][:, 0]


def force_sd(settings: FitSettings, field: FieldMap, folder: RunFolder) -> np.ndarray:
    """Standard deviation of the learned force on the grid of a map."""
    posterior = read_posterior(settings, folder)
    points = np.stack(np.meshgrid(field.x, field.y), axis=-1)
    return posterior.force_sd(points.reshape(-1, 2)).reshape(field.force.shape)
