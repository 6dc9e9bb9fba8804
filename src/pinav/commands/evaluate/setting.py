"""The setting of an evaluation: the run, the data, the truth, and predictions."""

import dataclasses
from pathlib import Path

import equinox as eqx
import numpy as np

from pinav.commands.data_file import with_all_channels
from pinav.commands.fitted_run import FittedRun
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
from pinav.scenarios import source_system
from pinav.systems import System
from pinav.trajectories import Trajectories, load


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

    subject: FittedRun
    data: Trajectories
    truth: System | None
    regions: Regions
    estimate: bool

    @property
    def domain(self) -> float:
        """Extent of the training data [L]; rollouts that err by more diverged."""
        return extent(self.subject.data)


def force_fields(model: Swimmer, setting: Setting) -> tuple[FieldMap, FieldMap]:
    """Learned and true force around the training data."""
    assert setting.truth is not None
    training = setting.subject.data
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


def starts_are_estimated(subject: FittedRun, data: Trajectories) -> bool:
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


def read_data(path: Path, subject: FittedRun) -> Trajectories:
    """Trajectories to score; positions alone get velocities that nobody observed.

    Raises:
        InputError: the file cannot be read, or its channels are not the model's.
    """
    data = with_all_channels(load(path), subject.system)
    if len(data.channels) != len(subject.system.channels):
        raise InputError(
            f"{path}: expected the channels {', '.join(subject.system.channels)} of "
            f"the run, or the positions among them, got {', '.join(data.channels)}"
        )
    return data


def true_scenario(data: Trajectories, subject: FittedRun) -> System | None:
    """The scenario that either the data or the training data were simulated from."""
    for trajectories in (data, subject.data):
        source = source_system(trajectories.provenance)
        if source is not None and source.environment is not None:
            return source
    return None
