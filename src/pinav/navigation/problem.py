"""A navigation problem: a task, and what is known of its environment."""

import dataclasses
from collections.abc import Mapping, Sequence

import jax
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from pinav.fitting import Posterior
from pinav.navigation.adaptive.scores import ORACLE
from pinav.navigation.control.controller import AbstractController
from pinav.navigation.control.default import controller
from pinav.navigation.task.objectives import ReachGoal
from pinav.navigation.task.steering import SteeredSwimmer, greatest_thrust, physics_only
from pinav.navigation.task.task import Task
from pinav.navigation.trials.closed_loop import Episodes, concatenate_episodes, run_many
from pinav.trajectories import Trajectories

LEARNED = "learned"
"""The controller that plans with the learned model."""

PHYSICS = "physics only"
"""The controller that plans with the model without its environment."""


@dataclasses.dataclass(frozen=True)
class Evidence:
    """A fit of trajectories with a posterior, which further ones can improve.

    Attributes:
        posterior: of the model.
        noise: standard deviation of what was observed.
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
        model: the fitted swimmer.
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

        Args:
            name: one of `models`.

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
