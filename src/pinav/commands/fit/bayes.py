"""The Bayesian fit of a run: model, posterior, and what the evidence chose."""

from typing import Any

import msgspec
import numpy as np

from pinav.commands.fit.settings import FitSettings
from pinav.commands.models import (
    CONSTANTS,
    build_model,
    fit_constants,
    fit_model,
    fit_trainable,
    fitted_summary,
    model_summary,
)
from pinav.commands.progress import BayesReporter
from pinav.evaluation import FieldMap, field_map
from pinav.fitting import (
    Estimate,
    EvidenceFit,
    Posterior,
    fit_bayes,
    fit_langevin,
    principal_drags,
    ravel_model,
    rotational_fraction,
)
from pinav.fitting.bayes.function_prior import TangentWeights
from pinav.forces import KernelForce, KernelMixture, KernelPotential
from pinav.runs import RunFolder
from pinav.systems import System
from pinav.trajectories import Trajectories

MODEL_FILE, POSTERIOR_FILE = "model.eqx", "posterior.npz"


def infer(
    settings: FitSettings, known: System, data: Trajectories, folder: RunFolder
) -> None:
    """Fit by the evidence; the model file is written last, when all else is there.

    Raises:
        FitError: the fit did not converge, or the data do not determine it.
    """
    summary = model_summary(settings.model, data)
    if settings.method == "langevin":
        _infer_langevin(settings, known, data, summary, folder)
        return
    with BayesReporter(folder, settings.model) as report:
        found = fit_bayes(
            fit_model(settings, known.swimmer, summary),
            data,
            learn=fit_constants(settings),
            noise=settings.noise,
            max_iterations=settings.max_steps,
            on_step=report,
        )
    arrays = {
        "iterations": np.array(found.iterations),
        "outcome": np.array(str(found.outcome)),
        "states": found.states,
    }
    estimates = _constants(settings, found) | parts(found, data)
    _write(settings, known, summary, (found, estimates, arrays), folder)


def _infer_langevin(settings, known, data, summary, folder: RunFolder) -> None:
    found = fit_langevin(fit_model(settings, known.swimmer, summary), data)
    arrays = {
        "iterations": np.array(1),
        "outcome": np.array(str(found.outcome)),
        "states": data.states,
    }
    estimates = found.constants | parts(found, data)
    _write(settings, known, summary, (found, estimates, arrays), folder)


def _write(settings, known, summary, results, folder: RunFolder) -> None:
    found, estimates, arrays = results
    chosen = found.hyperparameters
    constants = {
        f"constant/{name}": np.array([estimate.value, estimate.sd])
        for name, estimate in estimates.items()
    }
    folder.write_arrays(
        POSTERIOR_FILE,
        {
            "mean": found.posterior.mean,
            "covariance": found.posterior.covariance,
            "shape": chosen.shape,
            "amplitude": np.array(chosen.amplitude),
            "noise": np.array(chosen.noise),
            "log_evidence": np.array(chosen.log_evidence),
            **arrays,
            **_process_kernels(found),
            **constants,
        },
    )
    header = {
        "kind": "fit",
        "settings": msgspec.to_builtins(settings),
        "physics": known.name,
        "data": fitted_summary(summary, found.model.environment),
        "dtype": "float64",
    }
    folder.write_model(MODEL_FILE, header, found.model)


def _process_kernels(found) -> dict[str, np.ndarray]:
    """What the prior of a network is made of; nothing for other models."""
    weights = found.linear.weights
    if not isinstance(weights, TangentWeights):
        return {}
    kernels = weights.process.kernels
    return {
        "process/centers": np.asarray(kernels.centers),
        "process/width": np.asarray(kernels.width),
    }


def process_kernels(
    model: str, folder: RunFolder
) -> KernelForce | KernelPotential | None:
    """The kernels of the process that is the prior of a run's network, if it has one.

    Args:
        model: the network's name in `pinav fit`.
        folder: of the run.
    """
    stored = folder.read_arrays(POSTERIOR_FILE)
    if "process/centers" not in stored:
        return None
    kind = KernelForce if model == "neural-force" else KernelPotential
    return kind.untrained(stored["process/centers"], float(stored["process/width"]))


def _constants(settings, found: EvidenceFit) -> dict[str, Estimate]:
    """Each learned constant, by its name; the drag by its principal values."""
    plain = [name for name in settings.learn if name != "drag"]
    estimates = {name: found.constants[CONSTANTS[name]] for name in plain}
    if "drag" in settings.learn:
        drags = principal_drags(found.posterior)
        estimates |= {f"drag {name}": value for name, value in drags.items()}
    return estimates


def parts(found: EvidenceFit, data: Trajectories) -> dict[str, Estimate]:
    """The rotational fraction of a mixture on visited ground; nothing for others."""
    environment = found.model.environment
    if not isinstance(environment, KernelMixture):
        return {}
    field = field_map(environment, data)
    points = np.stack(np.meshgrid(field.x, field.y), axis=-1)
    visited = points[field.distance <= field.regions.visited]
    return {"rotational fraction": rotational_fraction(found.posterior, visited)}


def read_posterior(settings: FitSettings, folder: RunFolder) -> Posterior:
    """The posterior of a run of `infer`.

    Raises:
        InputError: a file of the run is missing or damaged.
    """
    model = folder.read_model(MODEL_FILE, build_model)
    stored = folder.read_arrays(POSTERIOR_FILE)
    free, _ = ravel_model(model, fit_trainable(settings))
    return Posterior(free, stored["mean"], stored["covariance"])


def metrics(folder: RunFolder) -> dict[str, Any]:
    """What the evidence chose, and the learned constants with their deviations."""
    stored = folder.read_arrays(POSTERIOR_FILE)
    return {
        "iterations": int(stored["iterations"]),
        "outcome": str(stored["outcome"]),
        "noise": float(stored["noise"]),
        "amplitude": float(stored["amplitude"]),
        "log_evidence": float(stored["log_evidence"]),
        "learned": {
            name.removeprefix("constant/"): {"value": pair[0], "sd": pair[1]}
            for name, pair in ((n, stored[n].tolist()) for n in sorted(stored))
            if name.startswith("constant/")
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
