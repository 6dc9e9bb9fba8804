"""The setting of an evaluation: a run, the trajectories to score, and the truth."""

import dataclasses
from pathlib import Path

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.commands.data_file import read_data
from pinav.commands.recording_settings import RecordingSettings
from pinav.dynamics import AbstractDynamics, Outcome, OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.evaluation import (
    START_SAMPLES,
    FieldMap,
    Regions,
    Starts,
    default_regions,
    estimate_starts,
    extent,
    field_map,
    predict,
    without_first,
)
from pinav.learning.learned import Learned
from pinav.learning.plan import with_all_channels
from pinav.scenarios import source_system
from pinav.systems import System
from pinav.trajectories import Trajectories


@dataclasses.dataclass(frozen=True)
class Setting:
    """The run, the data and the truth by which all models of a run are judged.

    Attributes:
        run: the fitted run.
        data: trajectories to score.
        truth: system that the data came from, where its environment is known.
        regions: lengths that tell visited from unvisited places.
        notes: sentences on what was left out.
    """

    run: Learned
    data: Trajectories
    truth: System | None
    regions: Regions
    notes: tuple[str, ...] = ()

    @property
    def domain(self) -> float:
        """Extent of the training data [L]; rollouts that err by more diverged."""
        return extent(self.run.data)

    @property
    def diffusion(self) -> float | None:
        """Diffusion coefficient that the fit found [L² T⁻¹], of stochastic paths."""
        evidence = self.run.evidence
        if evidence is None or "diffusion" not in evidence.constants:
            return None
        return evidence.constants["diffusion"].value

    @property
    def planar(self) -> bool:
        """The positions lie in the plane, so that there are maps."""
        return self.run.data.dim == 2

    @property
    def estimate(self) -> bool:
        """The first samples are no starts: incomplete, or noisy.

        Stochastic paths start at their first samples: no noise was found on them.
        """
        if not bool(self.data.observed[:, 0].all()):
            return True
        return self.run.posterior is not None and self.diffusion is None

    def force_fields(
        self, model: Swimmer | OverdampedSwimmer
    ) -> tuple[FieldMap, FieldMap]:
        """Learned and true force around the training data."""
        if self.truth is None or self.truth.environment is None:
            raise InputError("force: expected a system with a true environment")
        true = field_map(self.truth.environment, self.run.data)
        return field_map(model.environment, self.run.data), true


def read_setting(
    run: Path, data: Path, regions: Regions | None, recording: RecordingSettings
) -> Setting:
    """The setting of a run and a file of trajectories.

    Raises:
        InputError: the run holds no model, or the file cannot be read.
    """
    fitted = Learned.open(run)
    trajectories, notes = read_scored(data, fitted, recording)
    truth = true_system(fitted.system, trajectories, fitted.data)
    notes += _limits(fitted, truth)
    regions = default_regions(fitted.data) if regions is None else regions
    return Setting(fitted, trajectories, truth, regions, notes)


def read_scored(
    path: Path, run: Learned, recording: RecordingSettings
) -> tuple[Trajectories, tuple[str, ...]]:
    """Trajectories to score, and what was left out of them.

    Positions alone get velocities that nobody observed. Trajectories too short for an
    estimate of their start are left out.

    Raises:
        InputError: the file cannot be read, its channels are not the run's, or each
            trajectory is too short.
    """
    data = read_data(path, recording)
    data, wanted = with_all_channels(data, run.system), run.data.channels
    if data.channels != wanted:
        raise InputError(
            f"{path}: expected the channels {', '.join(wanted)} of the run, or the "
            f"positions among them, got {', '.join(data.channels)}"
        )
    long = np.flatnonzero(data.lengths > START_SAMPLES)
    if len(long) in (0, len(data)):
        return data, ()
    note = (
        f"{len(data) - len(long)} trajectories of {START_SAMPLES} samples or fewer are "
        "left out: their starts could not be estimated."
    )
    return data.select(long.tolist()), (note,)


def true_system(
    system: System, data: Trajectories, training: Trajectories
) -> System | None:
    """The system that the data, or else the training data, were simulated from.

    Raises:
        InputError: its state is not that of the system of the run.
    """
    for trajectories in (data, training):
        source = source_system(trajectories.provenance)
        if source is not None and source.environment is not None:
            if source.channels != system.channels:
                raise InputError(
                    f"data: simulated from system {source.name!r}, whose state is "
                    f"({', '.join(source.channels)}), but that of the run is "
                    f"({', '.join(system.channels)}); give data of the system that "
                    "was fitted"
                )
            return source
    return None


def _limits(run: Learned, truth: System | None) -> tuple[str, ...]:
    if truth is None or run.data.dim == 2:
        return ()
    return (
        f"The data have {run.data.dim} coordinates: maps, and with them the errors of "
        "the force by region, are made for planar data alone.",
    )


class Prediction(eqx.Module):
    """Rollouts of one model beside what was observed.

    Attributes:
        observed: the trajectories, what is not scored marked as not observed.
        ys: predicted states.
        outcomes: how the rollouts ended.
        starts: the estimated starts; None where the first samples were taken.
    """

    observed: Trajectories
    ys: Float[np.ndarray, "trajectory time state"]
    outcomes: tuple[Outcome, ...]
    starts: Starts | None


def predict_rollouts(
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
