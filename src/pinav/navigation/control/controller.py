"""Controllers: from an observation and a memory to the next command."""

import abc
from typing import Generic, TypeVar

import equinox as eqx
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from pinav.arguments import Scalar, State
from pinav.navigation.task.steering import Command

Controls = Float[Array, "step dim"]
"""Thrusts of the coming steps, in units of the greatest one."""

Memory = TypeVar("Memory", bound=PyTree)


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
