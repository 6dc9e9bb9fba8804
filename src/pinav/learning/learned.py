"""`Learned`: a fit with all that belongs to it, in memory and in a folder."""

import dataclasses
import functools
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from pinav.codec import decode_blank, encode
from pinav.dynamics import AbstractDynamics, with_dtype
from pinav.errors import InputError
from pinav.evaluation import FieldMap, exact_forces, require_x64
from pinav.fitting import AbstractLearned, Estimate, EvidenceFit, Posterior, is_network
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.summary import DataSummary, KnownSwimmer, ModelChoice
from pinav.forces import as_learned_force, split_structure
from pinav.learning.evidence import Evidence, SearchResult, with_units
from pinav.learning.findings import Findings
from pinav.learning.matching import Losses
from pinav.learning.plan import read_system_of, write_system_of
from pinav.learning.thermal import ThermalFindings
from pinav.learning.verdict import Verdict
from pinav.runs import RunFolder
from pinav.systems import System, WanderingVelocity
from pinav.trajectories import Trajectories, load, save

DATA_FILE = "data.npz"

MODEL = "model"
"""Name of the fitted model where there is one, and of its file."""

TEACHER_FILE = "teacher.eqx"
"""The model of the kernels from which a network was distilled."""

POSTERIOR, TEACHER, THERMAL, LOSSES = "posterior", "teacher", "thermal", "losses-model"
"""Names of the results beside a model that a run keeps."""

FINDINGS = "metrics"
"""Name of the result of a finished fit."""


@dataclasses.dataclass(frozen=True)
class ModelHeader:
    """The first line of a model file: how the model is built again."""

    choice: ModelChoice
    data: DataSummary
    dtype: str = "float64"


@dataclasses.dataclass(frozen=True)
class Learned(AbstractLearned):
    """A fit, or a finished run with several models.

    Attributes:
        place: where it is; None of one that was not saved.
        choice: what was fitted; of the first model where there are several.
        evidence: posterior and hyperparameters; None where the recipe has none.
        teacher: the fit of kernels, with the structure that it found, from which a
            network was distilled; None of any other.
        header: how the model is built again; None where there are several.
        found: what the fit has to say, where it is not in a folder.
    """

    place: RunFolder | None
    system: System
    data: Trajectories
    models: dict[str, AbstractDynamics]
    choice: ModelChoice
    evidence: Evidence | None
    teacher: "Learned | None" = None
    header: ModelHeader | None = None
    losses: Losses | None = None
    thermal: ThermalFindings | None = None
    found: Findings | None = None

    @classmethod
    def open(cls, path: Path | str) -> "Learned":
        """Read a run.

        Raises:
            InputError: the folder holds no run or no model, a file is damaged, or x64
                is switched off, or a network has no teacher although it had one.
        """
        require_x64("opening a run")
        folder = RunFolder.open(Path(path))
        names = folder.models()
        if not names:
            raise InputError(
                f"{path} holds no fitted model; give the folder that was the --out of "
                "a finished pinav fit"
            )
        system = read_system_of(folder)
        headers: list[ModelHeader] = []

        def build_untrained(content: Mapping[str, Any]) -> AbstractDynamics:
            headers.append(read_header(content))
            return build_model(headers[-1], system)

        models = {
            name.removesuffix(".eqx"): folder.read_model(name, build_untrained)
            for name in names
        }
        header = headers[0]
        run = cls(
            folder,
            system,
            load(folder.path / DATA_FILE),
            models,
            header.choice,
            _load(folder, POSTERIOR, Evidence),
            header=header,
            losses=_load(folder, LOSSES, Losses),
            thermal=_load(folder, THERMAL, ThermalFindings),
        )
        run.check_posterior(POSTERIOR)
        evidence = run.evidence
        if evidence is None or evidence.structure is None or not is_network(run.model):
            return run
        folder.manifest.check(TEACHER_FILE)
        model = folder.read_model(TEACHER_FILE, build_untrained)
        teacher = dataclasses.replace(
            run,
            models={MODEL: model},
            choice=headers[-1].choice,
            evidence=folder.load(TEACHER, Evidence),
            header=headers[-1],
        )
        teacher.check_posterior(TEACHER)
        return run.with_teacher(teacher)

    def with_teacher(self, teacher: "Learned") -> "Learned":
        """The same of a network that this fit of kernels taught."""
        assert self.evidence is not None
        force: Any = teacher.model
        evidence = dataclasses.replace(self.evidence, process=force.environment)
        return dataclasses.replace(self, evidence=evidence, teacher=teacher)

    def check_posterior(self, name: str) -> None:
        """Require that the posterior is that of the model, or raise InputError."""
        try:
            _ = self.posterior
        except ValueError as error:
            raise InputError(
                f"{self.path}: {name}.json is not of the same fit as its model "
                f"({error}); copy all files from one run"
            ) from error

    def write(self, folder: RunFolder) -> "Learned":
        """Write the fit into a run; the model last, which says that all is there."""
        assert self.header is not None
        save(self.data, folder.path / DATA_FILE, overwrite=True)
        folder.manifest.record(DATA_FILE)
        write_system_of(folder, self.system)
        results: dict[str, Any] = {
            POSTERIOR: self.evidence,
            THERMAL: self.thermal,
            LOSSES: self.losses,
        }
        if self.teacher is not None and self.teacher.header is not None:
            # The process of a network is the force of its teacher, which has a file.
            assert self.evidence is not None
            untaught = dataclasses.replace(self.evidence, process=None)
            results |= {POSTERIOR: untaught, TEACHER: self.teacher.evidence}
            write_model(folder, self.teacher.header, self.teacher.model, TEACHER_FILE)
        for name, result in results.items():
            if result is not None:
                folder.store(name, result)
        write_model(folder, self.header, self.model)
        return dataclasses.replace(self, place=folder)

    def save(self, path: Path | str, *, overwrite: bool = False) -> "Learned":
        """Keep the fit in a folder, which `open_run` and the commands of pinav read.

        Args:
            overwrite: replace the run that it holds.

        Raises:
            InputError: the folder holds another run, or something else.
        """
        config = {"run": {"command": "fit"}}
        folder = RunFolder.create(Path(path), config, overwrite=overwrite)
        kept = self.write(folder)
        folder.store(FINDINGS, self.findings)
        return kept

    @property
    def folder(self) -> RunFolder:
        """The folder that holds the fit.

        Raises:
            InputError: it was not saved.
        """
        if self.place is None:
            raise InputError("this fit was not saved, so that it has no folder")
        return self.place

    @property
    def path(self) -> Path | str:
        """The path of the folder, or what messages call a fit that was not saved."""
        return "the fit" if self.place is None else self.place.path

    @property
    def findings(self) -> Findings:
        """The findings of the fit; of a run, as it wrote them.

        Raises:
            InputError: the run is not finished, or is none of `pinav fit`.
        """
        if self.found is not None:
            return self.found
        return self.folder.load(FINDINGS, Findings)

    @property
    def verdict(self) -> Verdict | None:
        """The verdict of the fit; None of a run with several models."""
        if self.found is None and (MODEL not in self.models or not self._is_finished):
            return None
        return self.findings.verdict

    @property
    def _is_finished(self) -> bool:
        return self.folder.command == "fit" and self.folder.has(f"{FINDINGS}.json")

    @property
    def outcome(self) -> str:
        """The word for how the fit ended."""
        return self.findings.outcome

    @property
    def ending(self) -> str:
        """The word for how the fit ended by its own account, before any rollout."""
        if self.evidence is not None:
            return self.evidence.outcome
        assert self.losses is not None  # there is no third kind of recipe
        return self.losses.outcomes[0]

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on what limits the result, each with a remedy."""
        return self.findings.remarks

    @property
    def model(self) -> AbstractDynamics:
        """The fitted model.

        Raises:
            InputError: the run holds several.
        """
        if MODEL not in self.models:
            raise InputError(
                f"{self.path} holds several models ({', '.join(self.models)}); "
                "give the folder that was the --out of pinav fit"
            )
        return self.models[MODEL]

    @property
    def posterior(self) -> Posterior | None:
        """The posterior of the fit, if it has one."""
        return self._posterior

    @functools.cached_property
    def _posterior(self) -> Posterior | None:
        if self.evidence is None:
            return None
        visited = None if self.system.decays else self.data.seen_positions
        return self.evidence.posterior(self.model, self.choice, visited)

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
            estimates = self.evidence.constants
        elif MODEL in self.models:
            estimates = {
                name: Estimate(float(value), float("nan"))
                for name, path in self.choice.paths().items()
                if np.ndim(value := attrgetter(path)(self.model)) == 0
            }
        else:
            return {}
        return with_units(estimates, self.choice, self.model, self.system)

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

    def force(self, positions: ArrayLike | Sequence) -> Float[np.ndarray, "point dim"]:
        """The learned force [L T⁻²] on a swimmer at rest at points [L], one a row.

        Raises:
            InputError: the model has no force of the environment.
        """
        if not isinstance(self.model, KnownSwimmer):
            raise InputError(f"{self.path}: model {self.choice.name} has no force")
        return exact_forces(self.model.environment, np.asarray(positions, float))

    def force_sd(self, field: FieldMap) -> Float[np.ndarray, "y x 2"]:
        """Standard deviation of the learned force on the grid of a map.

        Raises:
            InputError: the run has no posterior.
        """
        if self.posterior is None:
            raise InputError(f"{self.path} has no posterior; fit with --recipe bayes")
        return self.posterior.force_sd(field.points).reshape(field.force.shape)


def read_header(content: Mapping[str, Any]) -> ModelHeader:
    """The header of a model file; long arrays in it are zero, as the file has them."""
    own = {name: part for name, part in content.items() if name != "pinav"}
    try:
        header = decode_blank(ModelHeader, own)
    except InputError as error:
        raise InputError(
            f"this run was fitted by another version of pinav ({error}); fit the data "
            "again"
        ) from error
    force = header.data.environment
    if force is None:
        return header
    # Numbers of a document are plain, and what a fit learns are arrays.
    force = eqx.tree_at(
        lambda f: jax.tree.leaves(f.trainable), force, replace_fn=jnp.asarray
    )
    data = dataclasses.replace(header.data, environment=force)
    return dataclasses.replace(header, data=data)


def build_model(header: ModelHeader, system: System) -> AbstractDynamics:
    """An untrained model of the shape that a model file's header describes."""
    model = build(header.choice, system.swimmer, header.data)
    return with_dtype(model, jnp.dtype(header.dtype))


def write_model(
    folder: RunFolder,
    header: ModelHeader,
    model: AbstractDynamics,
    name: str = f"{MODEL}.eqx",
) -> None:
    """Write a fitted model; last, as it says that all of its fit is there."""
    folder.write_model(name, encode(header).document, model)


def is_written(folder: RunFolder) -> bool:
    """The folder holds all of a fit."""
    names = set(folder.manifest.entries())
    return folder.has(f"{MODEL}.eqx") and bool(
        names & {f"{POSTERIOR}.json", f"{LOSSES}.json"}
    )


def of_evidence(
    header: ModelHeader,
    fit: EvidenceFit,
    system: System,
    data: Trajectories,
    search: SearchResult | None = None,
    support: float | None = None,
) -> Learned:
    """A fit by the evidence; the kernels of the header's model may be coarser.

    Args:
        search: what the search for a structure weighed; None without one.
        support: log evidence of a field beside commands over none [nats].
    """
    evidence = Evidence.of(fit, header.choice, data, search, support)
    header = dataclasses.replace(header, data=header.data.of_fit(fit.model))
    models: dict[str, AbstractDynamics] = {MODEL: fit.model}
    return Learned(None, system, data, models, header.choice, evidence, header=header)


def teacher_choice(fit: EvidenceFit, network: ModelChoice) -> ModelChoice:
    """The choice of the kernels from which a network was distilled."""
    _, rest = split_structure(fit.model.environment)
    kernels = as_learned_force(rest)
    assert kernels is not None
    return ModelChoice(kernels.kind, learn=network.learn)


def _load(folder: RunFolder, name: str, wanted: type[Any]) -> Any:
    return folder.load(name, wanted) if folder.has(f"{name}.json") else None


def _hashes(data: Trajectories) -> Iterator[bytes]:
    for piece in data:
        channels = piece.observed.any(axis=0)
        states = np.where(piece.observed, piece.states, 0.0)[:, channels]
        digest = hashlib.sha256(np.ascontiguousarray(piece.times, float).tobytes())
        digest.update(np.ascontiguousarray(states, float).tobytes())
        yield digest.digest()
