"""A navigation problem: a task, and what is known of its environment."""

import dataclasses
from collections.abc import Mapping, Sequence

import jax
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from pinav.dynamics import (
    AbstractDynamics,
    OverdampedSwimmer,
    Swimmer,
    takes_commands,
)
from pinav.errors import InputError
from pinav.evaluation import enclosing_cube
from pinav.fitting import AbstractLearned, Posterior
from pinav.navigation.adaptive.scores import ORACLE
from pinav.navigation.control.controller import AbstractController
from pinav.navigation.control.default import controller
from pinav.navigation.task.objectives import ReachGoal
from pinav.navigation.task.steering import SteeredSwimmer, greatest_thrust, physics_only
from pinav.navigation.task.task import Task, steered_swimmer
from pinav.navigation.task.way import Way
from pinav.navigation.trials.closed_loop import Episodes, concatenate_episodes, run_many
from pinav.scenarios import source_system
from pinav.trajectories import Trajectories

LEARNED = "learned"
"""The controller that plans with the learned model."""

PHYSICS = "physics only"
"""The controller that plans with the model without its environment."""


@dataclasses.dataclass(frozen=True)
class Evidence:
    """A fit of trajectories with a posterior, which further ones can improve.

    Attributes:
        states: smoothed states of the data.
    """

    posterior: Posterior
    noise: float
    states: Float[np.ndarray, "trajectory time state"]


@dataclasses.dataclass(frozen=True)
class NavigationProblem:
    """A task and what is known of it.

    Attributes:
        task: its truth is that of the system, or the model where there is none.
        data: what was fitted.
        units: units of the channels, and the order of the dynamics.
        samples: draws of the posterior; none where the fit has no posterior.
        truth: name of the system whose environment is the truth, where it is known.
        evidence: evidence of the fit, where further trajectories can be suggested.
    """

    task: Task
    model: SteeredSwimmer
    data: Trajectories
    units: Mapping[str, str]
    samples: tuple[SteeredSwimmer, ...] = ()
    truth: str | None = None
    evidence: Evidence | None = None

    @classmethod
    def of(
        cls, fit: AbstractLearned, way: Way, *, samples: int = 8, seed: int = 0
    ) -> "NavigationProblem":
        """The problem of going a way through the force that a fit has learned.

        Args:
            fit: the fit.
            way: the way.
            samples: models drawn from the posterior; 0 takes the model for true.
            seed: seed of these draws.

        Raises:
            InputError: the fit is not of a swimmer in the plane or in space, or the way
                has places of another dimension.
        """
        model, dim = fit.model, fit.data.dim
        if not isinstance(model, Swimmer | OverdampedSwimmer) or dim < 2:
            raise InputError(
                "navigate: expected a fit of a swimmer in the plane or in space, got "
                f"the model {fit.choice.name} of {', '.join(fit.data.channels)}"
            )
        if len(way.start) != dim:
            raise InputError(
                f"Way: expected places of {dim} coordinates, got {way.start}"
            )
        known, truth, source = model, None, source_system(fit.data.provenance)
        if source is not None and source.environment is not None:
            known, truth = source.true_swimmer, source.name
        corners = np.array(enclosing_cube(fit.data))
        task = way.task(model, known, "way", corners)
        return cls(
            task=task,
            model=steered_swimmer(task, model),
            samples=tuple(
                steered_swimmer(task, draw)
                for draw in _draws(fit, samples, seed)
                if isinstance(draw, Swimmer | OverdampedSwimmer)
            ),
            truth=truth,
            evidence=_evidence(fit, model),
            data=fit.data,
            units=dict(fit.units),
        )

    @property
    def goal(self) -> ReachGoal:
        """The middle of the goal, and its radius."""
        assert isinstance(self.task.objective, ReachGoal)
        return self.task.objective

    @property
    def truths(self) -> tuple[SteeredSwimmer, ...]:
        """Swimmers in which controllers are tried."""
        if self.truth is None and self.samples:
            return self.samples
        return (self.task.truth,)

    @property
    def thrust(self) -> float:
        """The greatest thrust that can be commanded."""
        task = self.task
        return float(greatest_thrust(self.model.actuator, task.limits, task.dim))

    @property
    def models(self) -> list[str]:
        """Models to plan with; the truth is left out where it is not known."""
        return [LEARNED, PHYSICS, *([ORACLE] if self.truth is not None else [])]

    def controller_with(self, name: str) -> AbstractController:
        """The controller that takes a model for true.

        Raises:
            InputError: start or goal are in a wall or outside the arena, or the goal
                cannot be reached with this thrust, as far as the model knows.
        """
        if name == LEARNED:
            return controller(self.task, self.model, samples=self.samples)
        model = physics_only(self.model) if name == PHYSICS else self.task.truth
        return controller(self.task, model)

    def attempt(
        self,
        steering: AbstractController,
        keys: PRNGKeyArray,
        numbers: Sequence[int] | None = None,
    ) -> Episodes:
        """Closed loops of a controller, one for each key, over the possible truths.

        Args:
            steering: what decides.
            keys: random keys of all loops.
            numbers: which of them are done, ascending; all unless given.
        """
        truths = self.truths[: len(keys)]
        chosen = np.arange(len(keys)) if numbers is None else np.asarray(numbers)
        parts, order = [], []
        for index, truth in enumerate(truths):
            some = np.flatnonzero(chosen % len(truths) == index)
            if len(some):
                picked = keys[chosen[some]]
                parts.append(run_many(self.task, steering, picked, truth=truth))
                order.append(some)
        return concatenate_episodes(parts).select(np.argsort(np.concatenate(order)))


def episode_keys(seed: int, count: int) -> PRNGKeyArray:
    """Random keys of so many closed loops."""
    return jax.random.split(jax.random.key(seed), count)


def _draws(fit: AbstractLearned, count: int, seed: int) -> list[AbstractDynamics]:
    if fit.posterior is None or count == 0:
        return []
    key = jax.random.fold_in(jax.random.key(seed), 1)
    return fit.posterior.samples(count, key=key)


def _evidence(fit: AbstractLearned, model: AbstractDynamics) -> Evidence | None:
    """The fit's evidence where the next trajectory can be suggested.

    Not of stochastic paths, whose states are not smoothed, nor in space, where
    candidates have no elevation.
    """
    evidence, posterior = fit.evidence, fit.posterior
    if evidence is None or posterior is None:
        return None
    if "diffusion" in evidence.constants or takes_commands(model):
        return None
    if fit.data.dim > 2:
        return None
    return Evidence(posterior, fit.noise, evidence.states)
