"""What is evaluated: the models of a run, its training data and its posterior."""

import dataclasses
from pathlib import Path
from typing import Any

import equinox as eqx
import msgspec
import numpy as np

from pinav.commands.fit.bayes import POSTERIOR_FILE, read_posterior
from pinav.commands.fit.command import FIT
from pinav.commands.fit.job import with_all_channels
from pinav.commands.fit.settings import FitSettings
from pinav.commands.models import build_model, known_physics
from pinav.dynamics import AbstractDynamics, Outcome, Swimmer
from pinav.errors import InputError
from pinav.evaluation import (
    START_SAMPLES,
    FieldMap,
    Regions,
    Starts,
    estimate_starts,
    extent,
    field_map,
    predict,
    without_first,
)
from pinav.fitting import Posterior
from pinav.runs import RunFolder
from pinav.scenarios import scenario
from pinav.systems import System
from pinav.trajectories import Trajectories, load


class Subject(eqx.Module):
    """A finished run, as far as its evaluation needs it.

    Attributes:
        models: by name, as in the tables.
        training: what they were fitted to.
        known: scenario that supplied propulsion and drag.
        settings: of `pinav fit`; None for `pinav reproduce`.
        posterior: of the fit, where it was Bayesian.
        noise: standard deviation of the observations that such a fit found.
    """

    models: dict[str, AbstractDynamics]
    training: Trajectories
    known: System
    settings: FitSettings | None = eqx.field(static=True)
    posterior: Posterior | None
    noise: float

    @property
    def horizon(self) -> float:
        """Longest time since the start in the training data [T]."""
        times = self.training.times
        return float((times[:, -1] - times[:, 0]).max())


def read_subject(run: Path) -> tuple[RunFolder, Subject]:
    """The run in a folder.

    Raises:
        InputError: the folder holds no run or no model, or a file is damaged.
    """
    folder = RunFolder.open(run)
    names = folder.models()
    if not names:
        raise InputError(f"{run} holds no model yet; finish it with --resume")
    models = {
        name.removesuffix(".eqx"): folder.read_model(name, build_model)
        for name in names
    }
    training = load(folder.path / "data.npz")
    if folder.command != FIT.name:
        return folder, Subject(models, training, scenario("paper"), None, None, 0.0)
    own = folder.settings()
    settings = msgspec.convert(own, FitSettings)
    known = known_physics(settings.physics, training)
    if settings.method != "bayes":
        return folder, Subject(models, training, known, settings, None, 0.0)
    noise = float(folder.read_arrays(POSTERIOR_FILE)["noise"])
    posterior = read_posterior(settings, folder)
    return folder, Subject(models, training, known, settings, posterior, noise)


@dataclasses.dataclass(frozen=True)
class Setting:
    """What all models of a run are measured by.

    Attributes:
        subject: the run.
        data: trajectories to score.
        truth: scenario that the data came from, where it is known.
        regions: lengths that tell visited from unvisited ground.
        estimate: whether starts are fitted to the first samples.
    """

    subject: Subject
    data: Trajectories
    truth: System | None
    regions: Regions
    estimate: bool

    @property
    def domain(self) -> float:
        """Extent of the training data [L]; rollouts that err by more diverged."""
        return extent(self.subject.training)


def force_fields(model: Swimmer, setting: Setting) -> tuple[FieldMap, FieldMap]:
    """Learned and true force around the training data."""
    assert setting.truth is not None
    training = setting.subject.training
    true = field_map(setting.truth.true_swimmer.environment, training)
    return field_map(model.environment, training), true


class Prediction(eqx.Module):
    """Rollouts of one model beside what was observed.

    Attributes:
        observed: the trajectories, what is not scored marked as not observed.
        ys: predicted states.
        outcomes: how the rollouts ended.
        starts: the estimated starts; None where the first samples were taken.
    """

    observed: Trajectories
    ys: np.ndarray
    outcomes: tuple[Outcome, ...]
    starts: Starts | None


def starts_are_estimated(subject: Subject, data: Trajectories) -> bool:
    """Whether the first samples are no starts: incomplete, or of noisy data."""
    return subject.posterior is not None or not bool(data.observed[:, 0].all())


def prediction(
    model: AbstractDynamics, data: Trajectories, *, estimate: bool
) -> Prediction:
    """Roll a model out from each start.

    Args:
        model: what predicts.
        data: what was observed.
        estimate: fit each start to the first samples, and score those after them.
    """
    if not estimate:
        return Prediction(data, *predict(model, data), None)
    starts = estimate_starts(model, data)
    ys, outcomes = predict(model, data, starts=starts.states)
    return Prediction(without_first(data, START_SAMPLES), ys, outcomes, starts)


def read_data(path: Path, subject: Subject) -> Trajectories:
    """Trajectories to score; positions alone get velocities that nobody observed.

    Raises:
        InputError: the file cannot be read, or its channels are not the model's.
    """
    data = with_all_channels(load(path), subject.known)
    if len(data.channels) != len(subject.known.channels):
        raise InputError(
            f"{path}: expected the channels {', '.join(subject.known.channels)} of "
            f"the run, or the positions among them, got {', '.join(data.channels)}"
        )
    return data


def true_scenario(data: Trajectories, subject: Subject) -> System | None:
    """The scenario that either the data or the training data were simulated from."""
    for provenance in (data.provenance, subject.training.provenance):
        if "scenario" in provenance:
            return scenario(provenance["scenario"])
    return None


def as_cell(value: float | int) -> Any:
    """A number for JSON and tables: NaN is None, infinity the word "diverged"."""
    if isinstance(value, int):
        return value
    if np.isnan(value):
        return None
    return "diverged" if np.isinf(value) else float(value)
