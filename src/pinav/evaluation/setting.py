"""The setting of an evaluation: a fit, the trajectories to score, and the truth."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.dynamics import AbstractDynamics, AbstractSwimmer, Outcome
from pinav.errors import InputError
from pinav.evaluation.force_fields import (
    FieldMap,
    Regions,
    default_regions,
    extent,
    field_map,
)
from pinav.evaluation.scores import predict
from pinav.evaluation.starts import (
    START_SAMPLES,
    Starts,
    estimate_starts,
    without_first,
)
from pinav.fitting import AbstractLearned
from pinav.scenarios import source_system
from pinav.systems import Observation, System
from pinav.trajectories import Trajectories, simulate, with_all_channels

HELD_OUT = 64
"""Number of held-out trajectories."""

HELD_OUT_SEED = 64_000
"""Key of their starts, which `pinav simulate` never draws from."""


@dataclasses.dataclass(frozen=True)
class Setting:
    """The fit, the data and the truth by which all models of a fit are judged.

    Attributes:
        truth: system that the data came from, where its environment is known.
    """

    fit: AbstractLearned
    data: Trajectories
    truth: System | None
    regions: Regions
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, fit: AbstractLearned, data: Trajectories, regions: Regions | None
    ) -> "Setting":
        """The setting of a fit; InputError if the data are not those of its system."""
        scored, notes = select_scored(data, fit)
        truth = true_system(fit.system, scored, fit.data)
        if truth is not None and fit.data.dim != 2:
            notes += (
                f"The data have {fit.data.dim} coordinates: maps, and with them the "
                "errors of the force by region, are made for planar data alone.",
            )
        regions = default_regions(fit.data) if regions is None else regions
        return cls(fit, scored, truth, regions, notes)

    @property
    def domain(self) -> float:
        """Extent of the training data [L]; rollouts that err by more diverged."""
        return extent(self.fit.data)

    @property
    def diffusion(self) -> float | None:
        """Diffusion coefficient that the fit found [L² T⁻¹], of stochastic paths."""
        if self.fit.evidence is None or "diffusion" not in self.fit.constants:
            return None
        return self.fit.constants["diffusion"].value

    @property
    def is_planar(self) -> bool:
        """The positions lie in the plane, so that there are maps."""
        return self.fit.data.dim == 2

    @property
    def estimates_starts(self) -> bool:
        """True if the first samples are incomplete or noisy.

        Stochastic paths start at their first samples: no noise was found on them.
        """
        if not bool(self.data.observed[:, 0].all()):
            return True
        return self.fit.posterior is not None and self.diffusion is None

    def force_fields(self, model: AbstractSwimmer) -> tuple[FieldMap, FieldMap]:
        """Learned and true force around the training data."""
        if self.truth is None or self.truth.environment is None:
            raise InputError("force: expected a system with a true environment")
        true = field_map(self.truth.environment, self.fit.data)
        return field_map(model.environment, self.fit.data), true


def select_scored(
    data: Trajectories, fit: AbstractLearned
) -> tuple[Trajectories, tuple[str, ...]]:
    """Trajectories to score, and what was left out of them.

    Positions alone get velocities that nobody observed. Trajectories too short for an
    estimate of their start are left out.
    """
    data, wanted = with_all_channels(data, fit.system), fit.data.channels
    if data.channels != wanted:
        raise InputError(
            f"data: expected the channels {', '.join(wanted)} of the run, or the "
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
    """The system that the data, or else the training data, were simulated from."""
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


def held_out(
    system: System, *, until: float | None = None, count: int = HELD_OUT
) -> Trajectories:
    """Solutions of the truth without observation noise, for scoring.

    Starts are drawn by the system's rule; that of `paper`, which has a single start,
    is the ring of `barrier-crossings` around its barrier. Stochastic truths give
    realisations of their own Brownian motion.

    Args:
        until: time [T] since the start up to which to solve, sampled as the system
            is; its own unless given.

    Raises:
        InputError: the truth is not stated, or no rule draws starts.
    """
    key = jax.random.key(HELD_OUT_SEED)
    system = system.with_starts(key, count)
    system = dataclasses.replace(system, observation=Observation())
    if until is not None:
        first, step = float(system.times[0]), float(system.times[1] - system.times[0])
        times = first + step * np.arange(round(until / step) + 1)
        system = dataclasses.replace(system, times=jnp.asarray(times))
    return simulate(system, key=jax.random.fold_in(key, 1))


class Prediction(eqx.Module):
    """Rollouts of one model beside what was observed.

    Attributes:
        observed: the trajectories, what is not scored marked as not observed.
        starts: the estimated starts; None where the first samples were taken.
    """

    observed: Trajectories
    ys: Float[np.ndarray, "trajectory time state"]
    outcomes: tuple[Outcome, ...]
    starts: Starts | None


def predict_rollouts(
    model: AbstractDynamics, data: Trajectories, *, estimate: bool
) -> Prediction:
    """Rollouts, from first samples or from starts that are estimated from them."""
    if not estimate:
        return Prediction(data, *predict(model, data), None)
    starts = estimate_starts(model, data)
    ys, outcomes = predict(model, data, starts=starts.states)
    return Prediction(without_first(data, START_SAMPLES), ys, outcomes, starts)
