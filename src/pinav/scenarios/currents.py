r"""Unknown currents that carry a swimmer without inertia: Zermelo's problem.

The swimmer's own velocity is known and of size 1, its heading turns once in 8 time
units; what is unknown is the current, $\dot x = n(\theta(t)) + u(x)$. So the current
is the environment of an `OverdampedSwimmer` of mobility 1.
"""

import jax.numpy as jnp
import numpy as np

from pinav.actuation import LinearProgramme, LinearResponse
from pinav.dynamics import OverdampedSwimmer
from pinav.forces import (
    AbstractForce,
    Advection,
    Domain,
    GaussianSwirl,
    PoiseuilleFlow,
    RollingPropulsion,
    ShearFlow,
    SumForce,
    UniformFlow,
    VortexFlow,
    ZeroForce,
)
from pinav.scenarios.starts_and_thrusts import with_random_starts
from pinav.systems import Observation, System, UniformStarts

BASIN = Domain((0.0, 0.0), (10.0, 10.0))
"""Where swimmers start."""

DURATION = 10.0
"""Last time of observation [T]."""

TURN = 8.0
"""Time of one turn of the heading [T]."""


@with_random_starts
def shear_current() -> System:
    """A shear of rate 0.2, at rest on the line y = 5: as fast as the swimmer at y = 0.

    It has 8 trajectories unless another number is given.
    """
    flow = ShearFlow(rate=0.2, origin=5.0)
    return _current("shear-current", Advection(flow))


@with_random_starts
def channel_current() -> System:
    """A channel flow of speed 0.7 between y = -3 and y = 13.

    It has 8 trajectories unless another number is given.
    """
    flow = PoiseuilleFlow(peak=0.7, middle=5.0, half_width=8.0)
    return _current("channel-current", Advection(flow))


@with_random_starts
def vortex_current() -> System:
    """A vortex of width 2 in the middle, counter-clockwise, 0.85 where it is fastest.

    It has 8 trajectories unless another number is given.
    """
    flow = VortexFlow(rate=0.7, center=[5.0, 5.0], width=2.0)
    return _current("vortex-current", Advection(flow))


@with_random_starts
def drift_current() -> System:
    """A drift of (0.25, -0.15) and a swirl of at most 0.24 around (6, 5).

    It has 8 trajectories unless another number is given.
    """
    drift = Advection(UniformFlow([0.25, -0.15]))
    swirl = GaussianSwirl(strength=1.0, center=[6.0, 5.0], width=2.5)
    return _current("drift-current", SumForce((drift, swirl)))


def _current(name: str, current: AbstractForce) -> System:
    times = jnp.linspace(0.0, DURATION, 41)
    programme = LinearProgramme(times, jnp.ones_like(times), 2 * np.pi * times / TURN)
    swimmer = OverdampedSwimmer(
        propulsion=RollingPropulsion(
            gain=jnp.eye(2), response=LinearResponse(), programme=programme
        ),
        environment=ZeroForce(),
        mobility=1.0,
    )
    return System(
        name=name,
        swimmer=swimmer,
        dim=2,
        environment=current,
        observation=Observation(noise=0.02),
        rule=UniformStarts(lower=BASIN.lower, upper=BASIN.upper),
        times=jnp.linspace(0.0, DURATION, round(10 * DURATION) + 1),
    )
