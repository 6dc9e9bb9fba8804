"""Doubt, influence, sensitivity and entropy production of one fit.

Each function raises `InputError` or `FitError` where its result does not exist.
"""

import dataclasses
from collections.abc import Iterator
from operator import attrgetter

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.analysis.entropy import EntropyProduction, entropy_production
from pinav.analysis.helmholtz import rotational_fractions, sample_forces
from pinav.analysis.sensitivity.influence import Influence, influence
from pinav.analysis.sensitivity.lyapunov import LyapunovMap, lyapunov_map
from pinav.analysis.sensitivity.sobol import RolloutStudy
from pinav.dynamics import OverdampedSwimmer, Swimmer, takes_commands
from pinav.errors import InputError
from pinav.evaluation import FieldMap
from pinav.fitting import AbstractLearned
from pinav.fitting.environments.summary import CONSTANTS
from pinav.forces import (
    KernelTensor,
    LinearDrag,
    MagneticPropulsion,
    ZeroForce,
    as_learned_force,
)

NO_POSTERIOR = "the run has no posterior; fit with --recipe bayes"

COMMANDED_SAMPLES = 250
"""Samples of the reference trajectory that a model driven by commands is rolled out."""

LYAPUNOV_POINTS = 25
"""Starts along each side of the map of Lyapunov exponents."""

MOST_SAMPLES = 4000
"""Samples at most over which entropy production is a mean."""


class Doubt(eqx.Module):
    """Posterior uncertainty of the learned force.

    Attributes:
        sd: standard deviation of the force on the grid [L T⁻²].
        significant: fraction of each region in which the force is above two standard
            deviations.
    """

    sd: Float[np.ndarray, "rows columns 2"]
    rotational: float
    significant: dict[str, float]


class TrajectoryEffect(eqx.Module):
    """First-order effect of leaving a trajectory out of the fit.

    Attributes:
        force: relative change of the force near the data.
        final: change of the final position of the reference rollout [L].
        change: of the force on the grid [L T⁻²].
    """

    trajectory: int
    leverage: float
    cook: float
    force: float
    final: float
    change: Float[np.ndarray, "rows columns 2"]


class ConstantEffect(eqx.Module):
    """Effect of a constant that is one percent larger; see `TrajectoryEffect`."""

    constant: str
    value: float
    learned: bool
    force: float
    final: float
    change: Float[np.ndarray, "rows columns 2"]


@dataclasses.dataclass(frozen=True)
class Subject:
    """The fit that is analysed, with the trajectory whose rollout is varied."""

    fit: AbstractLearned
    model: Swimmer | OverdampedSwimmer
    field: FieldMap
    reference: int

    @property
    def start(self) -> Float[np.ndarray, " state"]:
        """Start of the reference trajectory."""
        return self.fit.start(self.reference)

    @property
    def times(self) -> Float[np.ndarray, " time"]:
        """Times of the reference trajectory [T]; its beginning under commands.

        Every jump of a command ends a step of the solver, for each start of a map.
        """
        data, index = self.fit.data, self.reference
        times = data.times[index][: data.lengths[index]]
        return times[:COMMANDED_SAMPLES] if takes_commands(self.fit.model) else times

    @property
    def near(self) -> np.ndarray:
        """Grid points near the data."""
        return self.field.distance <= self.field.regions.near

    @property
    def has_potential(self) -> bool:
        """The learned force is the gradient of a learned potential."""
        learned = as_learned_force(self.model.environment)
        return learned is not None and learned.is_conservative

    def top_of(
        self, potential: Float[np.ndarray, "rows columns"]
    ) -> Float[np.ndarray, "2"]:
        """The place near the data where a potential on the grid is highest [L]."""
        top = np.where(self.near, potential, -np.inf).argmax()
        row, column = np.unravel_index(top, potential.shape)
        return np.array([self.field.x[column], self.field.y[row]])


def judge_significance(subject: Subject, draws: int, seed: int) -> Doubt:
    """Standard deviation of the force by the posterior; InputError without one."""
    posterior, field = subject.fit.posterior, subject.field
    if posterior is None:
        raise InputError(NO_POSTERIOR)
    sd = posterior.force_sd(field.points).reshape(field.force.shape)
    size = np.linalg.norm(field.force, axis=-1)
    significant = size > 2.0 * np.linalg.norm(sd, axis=-1)
    forces = sample_forces(posterior, field, draws, key=jax.random.key(seed))
    return Doubt(
        sd=sd,
        rotational=float(rotational_fractions(field, forces).std()),
        significant={
            name: float(significant[mask].mean())
            for name, mask in field.regions.masks(field.distance).items()
            if name != "unvisited" and mask.any()
        },
    )


def trace_influence(subject: Subject) -> Influence:
    """Effect of each trajectory and each constant on the parameters."""
    if subject.fit.evidence is None:
        raise InputError(NO_POSTERIOR)
    if is_thermal(subject.fit):
        raise InputError(
            "it is defined for fits of trajectories, not of stochastic increments"
        )
    if takes_commands(subject.fit.model):
        raise InputError(
            "it is defined for fits without commands and wandering velocity"
        )
    model, fit = subject.model, subject.fit
    has = {
        "damping": isinstance(model, Swimmer) and isinstance(model.drag, LinearDrag),
        "gain": isinstance(model.propulsion, MagneticPropulsion),
    }
    constants = {n: attrgetter(path) for n, path in CONSTANTS.items() if has.get(n)}
    return influence(
        model,
        fit.data,
        fit.evidence.states,
        fit.evidence.hyperparameters,
        learn=fit.choice.constants,
        constants=constants,
        kernels=fit.evidence.process,
    )


def trajectory_effects(
    subject: Subject, effects: Influence
) -> tuple[TrajectoryEffect, ...]:
    """Effects of each trajectory on the force and on the end of the reference."""
    followed = _follow(subject, effects, effects.removals)
    leverages, distances = effects.leverages.tolist(), effects.distances.tolist()
    rows = enumerate(zip(leverages, distances, followed, strict=True))
    return tuple(
        TrajectoryEffect(index, leverage, distance, *effect)
        for index, (leverage, distance, effect) in rows
    )


def constant_effects(
    subject: Subject, effects: Influence
) -> tuple[ConstantEffect, ...]:
    """Effect of a change of each constant by 1 %; InputError if there is none."""
    if not effects.constants:
        raise InputError("the physics has none")
    values = {
        name: float(attrgetter(CONSTANTS[name])(subject.model))
        for name in effects.constants
    }
    percents = [0.01 * values[n] * change for n, change in effects.constants.items()]
    followed = _follow(subject, effects, np.stack(percents))
    return tuple(
        ConstantEffect(name, value, name in subject.fit.choice.learn, *effect)
        for (name, value), effect in zip(values.items(), followed, strict=True)
    )


def _follow(
    subject: Subject, effects: Influence, changes: Float[np.ndarray, "change parameter"]
) -> Iterator[tuple[float, float, Float[np.ndarray, "rows columns 2"]]]:
    """The last three fields of the effect of each change of the parameters."""
    shape = subject.field.force.shape
    forces = effects.force_changes(subject.field.points, changes).reshape(-1, *shape)
    final = effects.final_changes(subject.start, subject.times, changes)[:, :2]
    near, size = subject.near, _rms(subject.field.force[subject.near])
    for force, end in zip(forces, final, strict=True):
        yield _rms(force[near]) / size, float(np.linalg.norm(end)), force


def vary_starts(subject: Subject) -> LyapunovMap:
    """Growth of separations over the starts of the reference rollout."""
    x, y = (
        np.linspace(axis[0], axis[-1], LYAPUNOV_POINTS)
        for axis in (subject.field.x, subject.field.y)
    )
    velocity = subject.start[2:]
    return lyapunov_map(
        subject.model,
        x,
        y,
        subject.times,
        velocity=(lambda _: velocity) if len(velocity) else None,
    )


def rollout_study(subject: Subject, landmark: Float[np.ndarray, "2"]) -> RolloutStudy:
    """The reference rollout, whose strengths and start can be varied."""
    if not isinstance(subject.model, Swimmer):
        raise InputError("they are varied for swimmers with inertia alone")
    near = subject.field.regions.visited
    return RolloutStudy(subject.model, subject.start, subject.times, landmark, near)


def is_thermal(fit: AbstractLearned) -> bool:
    """The fit is one of thermal motion."""
    return fit.evidence is not None and "diffusion" in fit.constants


def produce_entropy(fit: AbstractLearned) -> EntropyProduction:
    """Entropy production of thermal motion, with the current at the samples."""
    posterior, model, data = fit.posterior, fit.model, fit.data
    if posterior is None or not isinstance(model, OverdampedSwimmer):
        raise InputError("the run is no fit of thermal motion")
    if not isinstance(model.propulsion, ZeroForce):
        raise InputError(
            "the swimmer is driven by its propulsion, which is no steady state"
        )
    if getattr(model.environment, "is_conservative", False):
        raise InputError(
            "the model is a potential, which makes none; fit --model kernel-force"
        )
    samples = data.seen_positions
    samples = samples[:: max(len(samples) // MOST_SAMPLES, 1)]
    number = fit.constants["diffusion"]
    field = np.full(samples.shape, number.value)
    if isinstance(model.mobility, KernelTensor) and fit.system.thermal_energy:
        mobility = jax.vmap(model.mobility.diagonal)(jnp.asarray(samples))
        field = float(fit.system.thermal_energy) * np.asarray(mobility)
    relative = number.sd / number.value
    return entropy_production(posterior, samples, field, relative)


def _rms(values: Float[np.ndarray, "... 2"]) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=-1))))
