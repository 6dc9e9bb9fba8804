r"""Swimmers without inertia in three dimensions, among forces that they do not know.

The thrust n is known and turns from one direction to the next, so that each trajectory
sees much of the space: $\dot x = n(t) + F_e(x) + F_k(x)$. As in `currents` there is
one schedule for all trajectories, and the starts differ.
"""

import jax
import jax.numpy as jnp

from pinav.dynamics import OverdampedSwimmer
from pinav.forces import (
    Domain,
    HarmonicTrap,
    ZeroForce,
    random_barriers,
)
from pinav.scenarios.starts_and_thrusts import out_and_back, with_random_starts
from pinav.systems import Observation, System, UniformStarts

BOX = Domain((0.0, 0.0, 0.0), (10.0, 10.0, 10.0))
"""Where centres of obstacles and starts are."""

FIELD_SEED = 12
"""The field is drawn once: keys of the scenario change its starts, not its world."""

DURATION, HELD = 30.0, 1.0
"""Last time of observation, and how long a direction of the thrust is held [T]."""

THRUST = 2.0
"""While recordings are made: more than the obstacles push."""


@with_random_starts
def box() -> System:
    """Twelve soft obstacles in a box of 10 by 10 by 10, which a swimmer goes round.

    Gaussian barriers that keep apart, of heights uniform in [2, 4] and widths in
    [1.6, 2]: the steepest push with up to 1.3. The field is the same for every key. A
    known trap of stiffness 0.1 about the middle, such as that of a standing wave of
    sound, keeps swimmers in the box. Starts are uniform in the box; a thrust of 2
    drives them out and back along one direction after the other, for a time unit each
    way. Observed every 0.2 for 30 time units, with an error of 0.02. Expected: each
    swimmer sees the space about its start and slides off the obstacles there.

    It has 16 trajectories unless another number is given.
    """
    field = random_barriers(
        BOX, 12, heights=(2.0, 4.0), widths=(1.6, 2.0), key=jax.random.key(FIELD_SEED)
    )
    return System(
        name="box",
        swimmer=OverdampedSwimmer(
            out_and_back(DURATION, HELD, THRUST),
            ZeroForce(),
            1.0,
            known_force=HarmonicTrap(0.1, [5.0, 5.0, 5.0]),
        ),
        dim=3,
        environment=field,
        observation=Observation(noise=0.02),
        rule=UniformStarts(lower=BOX.lower, upper=BOX.upper, count=16),
        times=jnp.linspace(0.0, DURATION, 151),
    )
