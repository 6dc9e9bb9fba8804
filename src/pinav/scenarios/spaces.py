r"""Swimmers without inertia in three dimensions, among forces that they do not know.

The thrust of size 1 is known and turns from one direction to the next, so that each
trajectory sees much of the space: $\dot x = n(t) + F_e(x) + F_k(x)$. As in `currents`
there is one schedule for all trajectories, and the starts differ.
"""

import jax
import jax.numpy as jnp
import numpy as np

from pinav.dynamics import OverdampedSwimmer
from pinav.forces import (
    AbstractForce,
    Domain,
    HarmonicTrap,
    ScheduledThrust,
    ZeroForce,
    random_barriers,
)
from pinav.scenarios.random_starts import with_random_starts
from pinav.systems import Observation, System, UniformStarts

BOX = Domain((0.0, 0.0, 0.0), (10.0, 10.0, 10.0))
"""Where centres of obstacles and starts are."""

FIELD_SEED = 12
"""The field is drawn once: keys of the scenario change its starts, not its world."""

DURATION, HELD = 15.0, 1.0
"""Last time of observation, and how long a direction of the thrust is held [T]."""


@with_random_starts
def box() -> System:
    """Twelve soft obstacles in a box of 10 by 10 by 10, which a swimmer goes round.

    Gaussian barriers that keep apart, of heights uniform in [2, 4] and widths in
    [1.6, 2]: the steepest push with up to 1.3, more than the thrust of 1. The field is
    the same for every key. A known trap of stiffness 0.04 about the middle, such as
    that of a standing wave of sound, keeps swimmers in the box. Starts are uniform in
    the box; the thrust turns to another direction every time unit. Observed every 0.2
    for 15 time units, with an error of 0.02. Expected: swimmers slide off the obstacles
    and between them.

    It has 16 trajectories unless another number is given.
    """
    field = random_barriers(
        BOX, 12, heights=(2.0, 4.0), widths=(1.6, 2.0), key=jax.random.key(FIELD_SEED)
    )
    return System(
        name="box",
        swimmer=OverdampedSwimmer(
            turning_thrust(),
            ZeroForce(),
            1.0,
            known_force=HarmonicTrap(0.04, [5.0, 5.0, 5.0]),
        ),
        dim=3,
        environment=field,
        observation=Observation(noise=0.02),
        rule=UniformStarts(lower=BOX.lower, upper=BOX.upper, count=16),
        times=jnp.linspace(0.0, DURATION, 76),
    )


def turning_thrust() -> AbstractForce:
    """A thrust of size 1 that jumps from direction to direction, all around.

    Heights along z and angles about it advance by irrational parts of a turn, so that
    the directions of any few neighbours differ much.
    """
    times = np.arange(0.0, DURATION, HELD)
    height = 2 * np.modf(times / HELD * (np.sqrt(2.0) - 1))[0] - 1
    angle = 2 * np.pi * times / HELD * (np.sqrt(5.0) - 1) / 2
    across = np.sqrt(1 - height**2)
    directions = np.stack(
        [across * np.cos(angle), across * np.sin(angle), height], axis=1
    )
    thrust = jnp.asarray(directions)
    return ScheduledThrust(jnp.asarray(times), thrust, thrust, 0.0, 0.0)
