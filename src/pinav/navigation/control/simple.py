"""The simplest controller, and other models than a learned one.

Physics alone and the oracle are any controller with another model: `physics_only`, and
the truth of the task.
"""

import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.navigation.control.controller import AbstractController, Observation
from pinav.navigation.task.objectives import AbstractObjective
from pinav.navigation.task.steering import (
    Command,
    CommandLimits,
    SteeredSwimmer,
    direction_angles,
)
from pinav.navigation.task.task import Task


class StraightLine(AbstractController[tuple[()]]):
    """Straight to the target with all thrust, whatever is in between.

    Attributes:
        objective: what is to be done.
        limits: what may be commanded.
    """

    objective: AbstractObjective
    limits: CommandLimits

    def start(self, observation: Observation) -> tuple[()]:
        return ()

    def __call__(
        self, observation: Observation, memory: tuple[()], *, key: PRNGKeyArray
    ) -> tuple[Command, tuple[()]]:
        target = self.objective.target(observation.time)
        offset = target - observation.state[: target.shape[0]]
        frequency = jnp.full((1,), self.limits.max_frequency, offset.dtype)
        return jnp.concatenate([frequency, direction_angles(offset)]), ()


def steered_swimmer(
    task: Task, dynamics: Swimmer | OverdampedSwimmer
) -> SteeredSwimmer:
    """Fitted dynamics under the commands of a task."""
    return SteeredSwimmer(dynamics, task.truth.actuator)


def physics_only(model: SteeredSwimmer) -> SteeredSwimmer:
    """The model without its environment."""
    return SteeredSwimmer(model.dynamics.without_environment(), model.actuator)
