"""Starts that follow a rule, and schedules of the thrust, of built-in systems."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from pinav.forces import ScheduledThrust
from pinav.systems import System


@runtime_checkable
class Scenario(Protocol):
    """A named system."""

    def __call__(
        self, key: PRNGKeyArray | None = None, count: int | None = None
    ) -> System:
        """The system with starts of its rule, by default of `jax.random.key(0)`."""
        ...


def with_random_starts(build: Callable[[], System]) -> Scenario:
    """A scenario from a function that states a system and the rule of its starts."""

    def scenario(key: PRNGKeyArray | None = None, count: int | None = None) -> System:
        return build().with_starts(key, count)

    scenario.__doc__, scenario.__name__ = build.__doc__, build.__name__
    return scenario


def out_and_back(
    duration: float, held: float, size: float, *, steep: float = 1.0
) -> ScheduledThrust:
    """A thrust that jumps from direction to direction, each followed by its opposite.

    Heights along z and angles about it advance by irrational parts of a turn, so that
    the directions of any few neighbours differ much. Out and back, so that a swimmer
    stays near its start: one schedule for all would else herd them together.

    Args:
        held: duration of each direction [T].
        size: magnitude of the thrust.
        steep: greatest component along z of a direction of length 1.
    """
    times = np.arange(0.0, duration, held)
    pair = np.arange(len(times)) // 2
    height = steep * (2 * np.modf(pair * (np.sqrt(2.0) - 1))[0] - 1)
    angle = 2 * np.pi * pair * (np.sqrt(5.0) - 1) / 2
    across = np.sqrt(1 - height**2)
    outward = np.stack([across * np.cos(angle), across * np.sin(angle), height], axis=1)
    sign = np.where(np.arange(len(times)) % 2 == 0, size, -size)
    thrust = jnp.asarray(sign[:, None] * outward)
    return ScheduledThrust(jnp.asarray(times), thrust, thrust, 0.0, 0.0)
