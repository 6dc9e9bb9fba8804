"""Controllers: from an observation and a memory to the next command."""

import abc
from typing import Generic, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from pinav.arguments import Scalar, State
from pinav.navigation.task.objectives import AbstractObjective
from pinav.navigation.task.steering import Command, CommandLimits, direction_angles

Controls = Float[Array, "step dim"]
"""Thrusts of the coming steps, in units of the greatest one."""

Memory = TypeVar("Memory")


class Observation(eqx.Module):
    """The information that a controller gets at a control step.

    Attributes:
        time: now [T].
        state: the state, with the error of the sensor.
        pending: commands that were given and have not come into force, the oldest
            first; the oldest is in force now. One row where there is no delay: the
            command in force until now.
    """

    time: Scalar
    state: State
    pending: Float[Array, "command dim"]


class AbstractController(eqx.Module, Generic[Memory]):
    """A pure function from observation and memory to command and memory.

    It can be jitted, scanned over time and mapped over seeds.
    """

    @abc.abstractmethod
    def start(self, observation: Observation) -> Memory:
        """Memory before the first step."""

    @abc.abstractmethod
    def __call__(
        self, observation: Observation, memory: Memory, *, key: PRNGKeyArray
    ) -> tuple[Command, Memory]:
        """Command for the coming step, not yet clipped, and memory for the next."""


class StraightLine(AbstractController[tuple[()]]):
    """Straight to the target with all thrust, whatever is in between."""

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
