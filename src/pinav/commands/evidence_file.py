"""The posterior of a fit by the evidence, as a run keeps it in `posterior.npz`."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from pinav.commands.constants import estimated_constants, rotational_part
from pinav.dynamics import AbstractDynamics
from pinav.errors import InputError
from pinav.fitting import (
    Estimate,
    EvidenceFit,
    Hyperparameters,
    Posterior,
    ravel_model,
)
from pinav.fitting.bayes.function_prior import TangentWeights
from pinav.fitting.environments.choice import ModelChoice
from pinav.forces import AbstractLearnedForce, KernelForce, KernelPotential
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories

MODEL_FILE, POSTERIOR_FILE = "model.eqx", "posterior.npz"

TEACHER_MODEL_FILE, TEACHER_POSTERIOR_FILE = "teacher.eqx", "teacher.npz"
"""Of the fit of kernels from which a network was distilled."""


class StructureSearch(NamedTuple):
    """What a search for a structure of the force came to.

    Attributes:
        gain: log evidence of the structured force over the free one [nats]; NaN where
            no structure explained the data well enough to be fitted.
        rotation: log evidence of a rotational part beside a potential [nats]; NaN where
            none was weighed.
    """

    gain: float
    rotation: float = float("nan")


@dataclasses.dataclass(frozen=True)
class EvidenceResult:
    """The result of a fit by the evidence, as a run keeps it.

    Attributes:
        posterior: of the learned parameters.
        hyperparameters: chosen by the evidence.
        constants: learned constants by name.
        states: smoothed states of the training trajectories.
        outcome: the word for how the fit ended.
        iterations: steps taken.
        goodness: a sentence on whether the residuals look like noise; empty where
            nothing can be said.
        process: the force whose process is the prior of a network, if it is one.
        structure: what the search for a structure came to; None without a search.
        support: log evidence of a field beside commands over none [nats]; None where it
            was not asked.
    """

    posterior: Posterior
    hyperparameters: Hyperparameters
    constants: dict[str, Estimate]
    states: Float[np.ndarray, "trajectory time state"]
    outcome: str
    iterations: int
    goodness: str = ""
    process: AbstractLearnedForce | None = None
    structure: StructureSearch | None = None
    support: float | None = None


def write_evidence(
    folder: RunFolder,
    choice: ModelChoice,
    fit: EvidenceFit,
    data: Trajectories,
    structure: StructureSearch | None = None,
    support: float | None = None,
    *,
    name: str = POSTERIOR_FILE,
) -> None:
    """Write what a fit by the evidence has found beside its model."""
    chosen = fit.hyperparameters
    estimates = estimated_constants(fit, choice) | rotational_part(fit, data)
    constants = {
        f"constant/{name}": np.array([estimate.value, estimate.sd])
        for name, estimate in estimates.items()
    }
    folder.write_arrays(
        name,
        {
            "mean": fit.posterior.mean,
            "covariance": fit.posterior.covariance,
            "shape": chosen.shape,
            "amplitude": np.array(chosen.amplitude),
            "noise": np.array(chosen.noise),
            "log_evidence": np.array(chosen.log_evidence),
            "iterations": np.array(fit.iterations),
            "outcome": np.array(str(fit.outcome)),
            "goodness": np.array(fit.goodness.statement if fit.goodness else ""),
            "states": data.states if fit.states is None else fit.states,
            # Where a structure was sought the process is that of the teacher's file.
            **(
                _process_arrays(fit)
                if structure is None
                else {
                    "structure/gain": np.array(structure.gain),
                    "structure/rotation": np.array(structure.rotation),
                }
            ),
            **({} if support is None else {"support": np.array(support)}),
            **constants,
        },
    )


def _process_arrays(fit: EvidenceFit) -> dict[str, np.ndarray]:
    """The kernels of the process that is the prior of a network; else nothing."""
    weights = fit.linear.weights
    if not isinstance(weights, TangentWeights):
        return {}
    kernels: Any = weights.process.kernels
    return {
        "process/centers": np.asarray(kernels.centers),
        "process/width": np.asarray(kernels.width),
    }


def read_evidence(
    folder: RunFolder,
    choice: ModelChoice,
    model: AbstractDynamics,
    name: str = POSTERIOR_FILE,
) -> EvidenceResult:
    """Read it again.

    Args:
        folder: of the run.
        choice: what was fitted.
        model: the fitted model.
        name: of the file.

    Raises:
        InputError: the file is damaged, or is that of another fit.
    """
    folder.check_file(name)
    stored = folder.read_arrays(name)
    try:
        free, theta = ravel_model(model, choice.trainable)
        if theta.shape != stored["mean"].shape:
            raise InputError(
                f"{folder.path}: {name} is not of the same fit as its model; copy "
                "all files from one run"
            )
        hyperparameters = Hyperparameters(
            shape=stored["shape"],
            amplitude=float(stored["amplitude"]),
            noise=float(stored["noise"]),
            log_evidence=float(stored["log_evidence"]),
        )
        return EvidenceResult(
            posterior=Posterior(
                free, stored["mean"], stored["covariance"], hyperparameters
            ),
            hyperparameters=hyperparameters,
            constants={
                name.removeprefix("constant/"): Estimate(*map(float, stored[name]))
                for name in sorted(stored)
                if name.startswith("constant/")
            },
            states=stored["states"],
            outcome=str(stored["outcome"]),
            iterations=int(stored["iterations"]),
            goodness=str(stored["goodness"]) if "goodness" in stored else "",
            process=_read_process(choice, stored),
            structure=StructureSearch(
                float(stored["structure/gain"]),
                float(stored.get("structure/rotation", np.nan)),
            )
            if "structure/gain" in stored
            else None,
            support=float(stored["support"]) if "support" in stored else None,
        )
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{folder.path / name} is damaged ({error}); {folder.repair(name)}"
        ) from error


def _read_process(
    choice: ModelChoice, stored: dict[str, np.ndarray]
) -> KernelForce | KernelPotential | None:
    if "process/centers" not in stored:
        return None
    kind = KernelForce if choice.name == "neural-force" else KernelPotential
    return kind.with_zero_weights(
        stored["process/centers"], float(stored["process/width"])
    )
