"""`FittedRun`: a fit on disk, and the one way to read and to write it."""

import dataclasses
import hashlib
from collections.abc import Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Float

from pinav.commands.constants import estimated_constants, rotational_part
from pinav.commands.system_choice import read_system_of
from pinav.dynamics import AbstractDynamics, OverdampedSwimmer, with_dtype
from pinav.errors import InputError
from pinav.evaluation import FieldMap, require_x64
from pinav.fitting import (
    Estimate,
    EvidenceFit,
    Hyperparameters,
    Posterior,
    ravel_model,
)
from pinav.fitting.bayes.function_prior import TangentWeights
from pinav.fitting.environments.catalogue import (
    DataSummary,
    ModelChoice,
    build,
)
from pinav.fitting.environments.profiles import MobilitySummary
from pinav.forces import KernelForce, KernelPotential
from pinav.runs import RunFolder
from pinav.systems import System, WanderingVelocity
from pinav.trajectories import Trajectories, load, save

DATA_FILE, MODEL_FILE, POSTERIOR_FILE = "data.npz", "model.eqx", "posterior.npz"


class StructureSearch(NamedTuple):
    """What a search for a structure of the force came to.

    Attributes:
        gain: log evidence of the structured force over the free one [nats]; NaN where
            no structure explained the data well enough to be fitted.
    """

    gain: float


class ModelHeader(msgspec.Struct, frozen=True):
    """The first line of a model file: how the model is built again.

    Attributes:
        choice: its kind and size.
        data: what it takes from the data.
        dtype: floating-point type of its leaves.
    """

    choice: ModelChoice
    data: DataSummary
    dtype: str = "float64"


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
        process: kernels of the process that is the prior of a network, if it is one.
        structure: what the search for a structure came to; None without a search.
    """

    posterior: Posterior
    hyperparameters: Hyperparameters
    constants: dict[str, Estimate]
    states: Float[np.ndarray, "trajectory time state"]
    outcome: str
    iterations: int
    goodness: str = ""
    process: KernelForce | KernelPotential | None = None
    structure: StructureSearch | None = None


@dataclasses.dataclass(frozen=True)
class FittedRun:
    """A finished run with one model or several.

    Attributes:
        folder: where it is.
        system: what was known of the swimmer.
        data: the trajectories that were fitted.
        models: the fitted models, by the names of their files.
        choice: what was fitted; of the first model where there are several.
        evidence: posterior and hyperparameters; none where the recipe has none.
    """

    folder: RunFolder
    system: System
    data: Trajectories
    models: dict[str, AbstractDynamics]
    choice: ModelChoice
    evidence: EvidenceResult | None

    @classmethod
    def open(cls, path: Path) -> "FittedRun":
        """Read a run.

        Raises:
            InputError: the folder holds no run or no model, a file is damaged, or x64
                is switched off.
        """
        require_x64("opening a run")
        folder = RunFolder.open(path)
        names = folder.models()
        if not names:
            raise InputError(
                f"{path} holds no fitted model; give the folder that was the --out of "
                "a finished pinav fit"
            )
        system = read_system_of(folder)
        headers: list[ModelHeader] = []

        def build_untrained(content: dict[str, Any]) -> AbstractDynamics:
            headers.append(msgspec.convert(content, ModelHeader))
            return build_model(headers[-1], system)

        models = {
            name.removesuffix(".eqx"): folder.read_model(name, build_untrained)
            for name in names
        }
        choice = headers[0].choice
        evidence = None
        if folder.has(POSTERIOR_FILE):
            evidence = _read_evidence(folder, choice, models["model"])
        data = load(folder.path / DATA_FILE)
        return cls(folder, system, data, models, choice, evidence)

    @property
    def model(self) -> AbstractDynamics:
        """The fitted model.

        Raises:
            InputError: the run holds several.
        """
        if "model" not in self.models:
            raise InputError(
                f"{self.folder.path} holds several models ({', '.join(self.models)}); "
                "give the folder that was the --out of pinav fit"
            )
        return self.models["model"]

    @property
    def posterior(self) -> Posterior | None:
        """The posterior of the fit, if it has one."""
        return None if self.evidence is None else self.evidence.posterior

    @property
    def noise(self) -> float:
        """Standard deviation of the observations that the fit found; 0 without one."""
        return 0.0 if self.evidence is None else self.evidence.hyperparameters.noise

    @property
    def wandering(self) -> WanderingVelocity | None:
        """The wandering velocity as the fit found it, or as the system states it."""
        stated = self.system.wandering
        values: dict[str, float] = {} if stated is None else dict(vars(stated))
        for name, estimate in self.constants.items():
            kind, _, field = name.partition(".")
            if kind == "wandering":
                values[field] = estimate.value
        return WanderingVelocity(**values) if values else None

    @property
    def constants(self) -> dict[str, Estimate]:
        """The learned constants; their deviation is NaN without a posterior."""
        if self.evidence is not None:
            return self.evidence.constants
        paths = self.choice.paths() if "model" in self.models else {}
        return {
            name: Estimate(float(attrgetter(path)(self.model)), float("nan"))
            for name, path in paths.items()
        }

    @property
    def horizon(self) -> float:
        """Longest time since the start in the training data [T]."""
        times = self.data.times
        return float((times[:, -1] - times[:, 0]).max())

    def start(self, index: int) -> Float[np.ndarray, " state"]:
        """The start of a training trajectory: estimated, or its first sample."""
        states = self.data.states if self.evidence is None else self.evidence.states
        return states[index, 0]

    def shared_trajectories(self, data: Trajectories) -> int:
        """Number of the given trajectories that the fit has seen."""
        training = set(_hashes(self.data))
        return sum(piece in training for piece in _hashes(data))

    def is_training_data(self, data: Trajectories) -> bool:
        """The fit has seen at least one of these trajectories."""
        return self.shared_trajectories(data) > 0

    def force_sd(self, field: FieldMap) -> Float[np.ndarray, "y x 2"]:
        """Standard deviation of the learned force on the grid of a map.

        Raises:
            InputError: the run has no posterior.
        """
        if self.posterior is None:
            raise InputError(
                f"{self.folder.path} has no posterior; fit with --recipe bayes"
            )
        points = np.stack(np.meshgrid(field.x, field.y), axis=-1)
        sd = self.posterior.force_sd(points.reshape(-1, 2))
        return sd.reshape(field.force.shape)


def build_model(header: ModelHeader, system: System) -> AbstractDynamics:
    """An untrained model of the shape that a model file's header describes."""
    model = build(header.choice, system.swimmer, header.data)
    return with_dtype(model, jnp.dtype(header.dtype))


def save_data(folder: RunFolder, data: Trajectories) -> None:
    """Keep the trajectories that are fitted."""
    save(data, folder.path / DATA_FILE, overwrite=True)
    folder.record(DATA_FILE)


def write_model(
    folder: RunFolder,
    header: ModelHeader,
    model: AbstractDynamics,
    name: str = MODEL_FILE,
) -> None:
    """Write a fitted model; last, as it says that all of its fit is there."""
    folder.write_model(name, msgspec.to_builtins(header), model)


def write_fit(
    folder: RunFolder,
    header: ModelHeader,
    fit: EvidenceFit,
    data: Trajectories,
    structure: StructureSearch | None = None,
) -> None:
    """Write the model and the posterior of a fit by the evidence."""
    chosen = fit.hyperparameters
    estimates = estimated_constants(fit, header.choice) | rotational_part(fit, data)
    constants = {
        f"constant/{name}": np.array([estimate.value, estimate.sd])
        for name, estimate in estimates.items()
    }
    folder.write_arrays(
        POSTERIOR_FILE,
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
            **_process_arrays(fit),
            **(
                {}
                if structure is None
                else {"structure/gain": np.array(structure.gain)}
            ),
            **constants,
        },
    )
    summary = header.data.with_kernels_of(fit.model.environment)
    if isinstance(fit.model, OverdampedSwimmer):
        mobility = MobilitySummary.of(fit.model.mobility)
        summary = msgspec.structs.replace(summary, mobility=mobility)
    header = msgspec.structs.replace(header, data=summary)
    write_model(folder, header, fit.model)


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


def _read_evidence(
    folder: RunFolder, choice: ModelChoice, model: AbstractDynamics
) -> EvidenceResult:
    folder.check_file(POSTERIOR_FILE)
    stored = folder.read_arrays(POSTERIOR_FILE)
    try:
        free, theta = ravel_model(model, choice.trainable)
        if theta.shape != stored["mean"].shape:
            raise InputError(
                f"{folder.path}: {POSTERIOR_FILE} and {MODEL_FILE} are not of the same "
                "fit; copy both from one run"
            )
        hyperparameters = Hyperparameters(
            shape=stored["shape"],
            amplitude=float(stored["amplitude"]),
            noise=float(stored["noise"]),
            log_evidence=float(stored["log_evidence"]),
        )
        return EvidenceResult(
            posterior=Posterior(free, stored["mean"], stored["covariance"]),
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
            structure=StructureSearch(float(stored["structure/gain"]))
            if "structure/gain" in stored
            else None,
        )
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{folder.path / POSTERIOR_FILE} is damaged ({error}); "
            f"{folder.repair(POSTERIOR_FILE)}"
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


def _hashes(data: Trajectories) -> Iterator[bytes]:
    """A hash of the observed samples of each trajectory."""
    for piece in data:
        channels = piece.observed.any(axis=0)
        states = np.where(piece.observed, piece.states, 0.0)[:, channels]
        digest = hashlib.sha256(np.ascontiguousarray(piece.times, float).tobytes())
        digest.update(np.ascontiguousarray(states, float).tobytes())
        yield digest.digest()
