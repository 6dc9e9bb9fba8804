r"""Media whose drag is not that of a fluid at rest, and currents that carry a swimmer.

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
    BrinkmanTensor,
    ConstantDirector,
    Domain,
    InFlow,
    LinearDrag,
    PoiseuilleFlow,
    RollingPropulsion,
    ShearFlow,
    SumForce,
    TensorDrag,
    UniaxialTensor,
    UniformFlow,
    VortexFlow,
    WavyDirector,
    ZeroForce,
    gaussian_swirl,
)
from pinav.scenarios.catalogue import with_random_starts
from pinav.scenarios.crossings import DAMPING, MANY, RING, paper_swimmer, planar_system
from pinav.systems import Observation, System, UniformStarts


@with_random_starts
def anisotropic_drag() -> System:
    """The paper's barrier in aligned fibres, at 30 degrees to the x axis.

    The drag is 0.24 along and 0.48 across them; the ratio of 2 is that of slender
    bodies. Starts, thrust, times and noise are those of `barrier_crossings`. Expected:
    swimmers turn towards the fibres while they slow down. Default: 8 trajectories.
    """
    tensor = UniaxialTensor(0.24, 0.48, ConstantDirector(np.pi / 6))
    return planar_system(
        "anisotropic-drag", paper_swimmer(drag=TensorDrag(tensor)), RING
    )


@with_random_starts
def varying_director() -> System:
    """The medium of `anisotropic_drag` with a director that sways by 45 degrees.

    It sways about 30 degrees along x, with a wavelength of 12. Expected: no constant
    tensor explains the data. Default: 16 trajectories.
    """
    director = WavyDirector(np.pi / 6, np.pi / 4, [2 * np.pi / 12, 0.0])
    tensor = UniaxialTensor(0.24, 0.48, director)
    return planar_system(
        "varying-director", paper_swimmer(drag=TensorDrag(tensor)), MANY
    )


@with_random_starts
def porous() -> System:
    """The paper's barrier with four dense regions of a gel around it.

    Brinkman drag: 0.36 in the clear fluid, 2.8 times that in the middle of a region of
    width 1.5, where the swimmer's radius is 1.5 screening lengths. Starts, thrust,
    times and noise are those of `barrier_crossings`. Expected: swimmers that enter a
    dense region slow down there and leave it late. Default: 16 trajectories.
    """
    tensor = BrinkmanTensor(
        clear=DAMPING,
        radius=0.5,
        screening=jnp.full(4, 3.0),
        centers=jnp.array([[1.0, 3.0], [8.0, 1.0], [9.5, 7.5], [3.0, 9.5]]),
        width=1.5,
    )
    return planar_system("porous", paper_swimmer(drag=TensorDrag(tensor)), MANY)


@with_random_starts
def shear() -> System:
    """The paper's barrier in a shear flow of rate 0.06, at rest on the line y = 5.

    Drag acts on the velocity relative to the fluid. Starts, thrust, times and noise are
    those of `barrier_crossings`. Expected: swimmers above y = 5 are carried to the
    right, those below to the left, up to 10 length units. Default: 16 trajectories.
    """
    drag = InFlow(LinearDrag(DAMPING), ShearFlow(rate=0.06, origin=5.0))
    return planar_system("shear", paper_swimmer(drag=drag), MANY)


@with_random_starts
def poiseuille() -> System:
    """The paper's barrier in a channel flow of speed 0.6 between y = -5 and y = 15.

    Drag acts on the velocity relative to the fluid. Starts, thrust, times and noise are
    those of `barrier_crossings`. Expected: all swimmers are carried to the right, those
    in the middle of the channel farthest; the flow presses them against the barrier.
    Default: 16 trajectories.
    """
    flow = PoiseuilleFlow(peak=0.6, middle=5.0, half_width=10.0)
    drag = InFlow(LinearDrag(DAMPING), flow)
    return planar_system("poiseuille", paper_swimmer(drag=drag), MANY)


BASIN = Domain((0.0, 0.0), (10.0, 10.0))
"""Box of the starts."""

DURATION = 10.0
"""Last time of observation [T]."""

TURN = 8.0
"""Time of one turn of the heading [T]."""


@with_random_starts
def shear_current() -> System:
    """A shear of rate 0.2, at rest on the line y = 5: as fast as the swimmer at y = 0.

    Default: 8 trajectories.
    """
    flow = ShearFlow(rate=0.2, origin=5.0)
    return _current("shear-current", Advection(flow))


@with_random_starts
def channel_current() -> System:
    """A channel flow of speed 0.7 between y = -3 and y = 13.

    Default: 8 trajectories.
    """
    flow = PoiseuilleFlow(peak=0.7, middle=5.0, half_width=8.0)
    return _current("channel-current", Advection(flow))


@with_random_starts
def vortex_current() -> System:
    """A vortex of width 2 in the middle, counter-clockwise, 0.85 where it is fastest.

    Default: 8 trajectories.
    """
    flow = VortexFlow(rate=0.7, center=[5.0, 5.0], width=2.0)
    return _current("vortex-current", Advection(flow))


@with_random_starts
def drift_current() -> System:
    """A drift of (0.25, -0.15) and a swirl of at most 0.24 around (6, 5).

    Default: 8 trajectories.
    """
    drift = Advection(UniformFlow([0.25, -0.15]))
    swirl = gaussian_swirl(strength=1.0, center=[6.0, 5.0], width=2.5)
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
