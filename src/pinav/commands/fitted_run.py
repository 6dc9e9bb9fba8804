"""`FittedRun`: a fit on disk, and the one way to read and to write it."""

import dataclasses
import hashlib
from collections.abc import Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Float

from pinav.commands.evidence_file import (
    MODEL_FILE,
    POSTERIOR_FILE,
    TEACHER_MODEL_FILE,
    TEACHER_POSTERIOR_FILE,
    EvidenceResult,
    StructureSearch,
    read_evidence,
    write_evidence,
)
from pinav.commands.system_choice import read_system_of
from pinav.dynamics import AbstractDynamics, OverdampedSwimmer, with_dtype
from pinav.errors import InputError
from pinav.evaluation import FieldMap, require_x64
from pinav.fitting import (
    AbstractLearned,
    Estimate,
    EvidenceFit,
    Posterior,
    is_network,
)
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.choice import ModelChoice
from pinav.fitting.environments.profiles import MobilitySummary
from pinav.fitting.environments.summary import DataSummary
from pinav.forces import as_learned_force, split_structure
from pinav.runs import RunFolder
from pinav.systems import System, WanderingVelocity
from pinav.trajectories import Trajectories, load, save

DATA_FILE = "data.npz"


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
class FittedRun(AbstractLearned):
    """A finished run with one model or several.

    Attributes:
        folder: where it is.
        system: what was known of the swimmer.
        data: the trajectories that were fitted.
        models: the fitted models, by the names of their files.
        choice: what was fitted; of the first model where there are several.
        evidence: posterior and hyperparameters; none where the recipe has none.
        teacher: the fit of kernels, with the structure that it found, from which a
            network was distilled; None of any other.
    """

    folder: RunFolder
    system: System
    data: Trajectories
    models: dict[str, AbstractDynamics]
    choice: ModelChoice
    evidence: EvidenceResult | None
    teacher: "FittedRun | None" = None

    @classmethod
    def open(cls, path: Path) -> "FittedRun":
        """Read a run.

        Raises:
            InputError: the folder holds no run or no model, a file is damaged, or x64
                is switched off, or a network has no teacher although it had one.
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
            evidence = read_evidence(folder, choice, models["model"])
        data = load(folder.path / DATA_FILE)
        if (
            evidence is None
            or evidence.structure is None
            or not is_network(models["model"])
        ):
            return cls(folder, system, data, models, choice, evidence)
        folder.check_file(TEACHER_MODEL_FILE)
        teacher = folder.read_model(TEACHER_MODEL_FILE, build_untrained)
        theirs = headers[-1].choice
        taught = read_evidence(folder, theirs, teacher, TEACHER_POSTERIOR_FILE)
        own: Any = teacher
        evidence = dataclasses.replace(evidence, process=own.environment)
        lesson = cls(folder, system, data, {"model": teacher}, theirs, taught)
        return cls(folder, system, data, models, choice, evidence, lesson)

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
        values = {name: attrgetter(path)(self.model) for name, path in paths.items()}
        return {
            name: Estimate(float(value), float("nan"))
            for name, value in values.items()
            if np.ndim(value) == 0
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

    def force_sd(self, field: FieldMap) -> Float[np.ndarray, "y x 2"]:
        """Standard deviation of the learned force on the grid of a map.

        Raises:
            InputError: the run has no posterior.
        """
        if self.posterior is None:
            raise InputError(
                f"{self.folder.path} has no posterior; fit with --recipe bayes"
            )
        return self.posterior.force_sd(field.points).reshape(field.force.shape)


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
    support: float | None = None,
) -> None:
    """Write the model and the posterior of a fit by the evidence."""
    write_evidence(folder, header.choice, fit, data, structure, support)
    write_model(folder, _header_of(header, fit), fit.model)


def write_teacher(
    folder: RunFolder,
    header: ModelHeader,
    fit: EvidenceFit,
    data: Trajectories,
    structure: StructureSearch,
) -> None:
    """Write the fit of kernels from which a network was distilled.

    Args:
        folder: of the run.
        header: of the network.
        fit: of the kernels.
        data: to which both were fitted.
        structure: what the search came to.
    """
    _, rest = split_structure(fit.model.environment)
    kernels = as_learned_force(rest)
    assert kernels is not None
    choice = ModelChoice(kernels.kind, learn=header.choice.learn)
    header = msgspec.structs.replace(header, choice=choice)
    written = TEACHER_POSTERIOR_FILE
    write_evidence(folder, choice, fit, data, structure, name=written)
    write_model(folder, _header_of(header, fit), fit.model, TEACHER_MODEL_FILE)


def _header_of(header: ModelHeader, fit: EvidenceFit) -> ModelHeader:
    """The header of a fitted model, whose kernels may be finer than at first."""
    summary = header.data.with_kernels_of(fit.model.environment)
    if isinstance(fit.model, OverdampedSwimmer):
        mobility = MobilitySummary.of(fit.model.mobility)
        summary = msgspec.structs.replace(summary, mobility=mobility)
    return msgspec.structs.replace(header, data=summary)


def _hashes(data: Trajectories) -> Iterator[bytes]:
    """A hash of the observed samples of each trajectory."""
    for piece in data:
        channels = piece.observed.any(axis=0)
        states = np.where(piece.observed, piece.states, 0.0)[:, channels]
        digest = hashlib.sha256(np.ascontiguousarray(piece.times, float).tobytes())
        digest.update(np.ascontiguousarray(states, float).tobytes())
        yield digest.digest()
