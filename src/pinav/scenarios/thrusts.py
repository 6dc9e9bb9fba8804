"""Schedules of the thrust with which recordings in space are made."""

import jax.numpy as jnp
import numpy as np

from pinav.forces import ScheduledThrust


def out_and_back(
    duration: float, held: float, size: float, *, steep: float = 1.0
) -> ScheduledThrust:
    """A thrust that jumps from direction to direction, each followed by its opposite.

    Heights along z and angles about it advance by irrational parts of a turn, so that
    the directions of any few neighbours differ much. Out and back, so that a swimmer
    stays near its start: one schedule for all would else herd them together.

    Args:
        duration: of the schedule [T].
        held: how long a direction is held [T].
        size: of the thrust.
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
