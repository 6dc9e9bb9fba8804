r"""The paper's barrier and random hills, in fluids, media and flows; currents alone.

In a current the swimmer's own velocity is known and of size 1, its heading turns once
in 8 time units; what is unknown is the current, $\dot x = n(\theta(t)) + u(x)$. So the
current is the environment of an `OverdampedSwimmer` of mobility 1.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from pinav.actuation import LinearProgramme, LinearResponse, RotatingField
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.forces import (
    AbstractForce,
    Advection,
    BrinkmanTensor,
    CircularMotion,
    ConstantDirector,
    Domain,
    GaussianBarrier,
    InFlow,
    LinearDrag,
    MagneticPropulsion,
    Moving,
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
    random_barriers,
    random_fibres,
)
from pinav.scenarios.catalogue import SCENARIOS, with_random_starts
from pinav.systems import (
    AbstractStarts,
    CoastingStarts,
    Observation,
    RingStarts,
    System,
    UniformStarts,
)

DAMPING = 0.36
"""Drag of the paper's swimmer, as identified."""

RING = RingStarts(center=(5.0, 5.0), radius=7.0, spread=2.0, speeds=(2.5, 5.0))
"""Starts on a circle around the barrier, aimed near its centre."""

MANY = dataclasses.replace(RING, count=16)


def paper_barrier() -> GaussianBarrier:
    """The barrier of the paper, as identified."""
    return GaussianBarrier(height=5.25, center=[5.0, 5.0], width=2.9)


def paper_swimmer(
    environment: AbstractForce | None = None, drag: AbstractForce | None = None
) -> Swimmer:
    """The paper's swimmer; its barrier and linear drag unless others are given."""
    return Swimmer(
        propulsion=MagneticPropulsion(
            field=RotatingField(amplitude=1.0, frequency=2 * np.pi),
            moment=[0.0, 0.0, 1.0],
            gain=0.034,
            axis=[0.0, 1.0],
        ),
        drag=LinearDrag(damping=DAMPING) if drag is None else drag,
        environment=paper_barrier() if environment is None else environment,
    )


def planar_system(name: str, truth: Swimmer, rule: AbstractStarts) -> System:
    """A dimensionless system in the plane, observed every 0.1 up to t = 20."""
    return System(
        name=name,
        swimmer=truth.without_environment(),
        dim=2,
        environment=truth.environment,
        observation=Observation(noise=0.02),
        rule=rule,
        times=jnp.linspace(0.0, 20.0, 201),
    )


def paper(key: PRNGKeyArray | None = None, count: int | None = None) -> System:
    r"""The paper's benchmark: shot at a Gaussian barrier, stalled, rolled off.

    The constants that the paper does not print are *identified*: the row
    "physics-only" of its Table 2 depends on them alone, and least squares on that
    row gives these values (one point of a family; docs/benchmark.md). The swimmer
    all but stalls near the top of the barrier at about 7 s, so the rest of the
    trajectory is very sensitive to the start: keep all digits.

    Raises:
        InputError: `count` is neither None nor 1.

    References:
        PI-NAV paper, eqs. (1)-(2), Table 1 and Table 2.
    """
    del key
    if count not in (None, 1):
        raise InputError(
            f"scenario 'paper' has one fixed start, so --count {count} cannot be; "
            "choose barrier-crossings for more of them"
        )
    return System(
        name="paper",
        swimmer=paper_swimmer().without_environment(),
        dim=2,
        environment=paper_barrier(),
        starts=jnp.array([[0.0, 0.0, 3.503477, 3.439507]]),
        rule=RING,
        times=jnp.linspace(0.0, 50.0, 501),
    )


SCENARIOS["paper"] = paper


@with_random_starts
def barrier_crossings() -> System:
    r"""Noisy shots at the paper's barrier, from all around it.

    The swimmers start on the circle of radius 7 about the barrier's centre, at uniform
    angles, aimed at the centre plus a normal offset of standard deviation 2 in each
    coordinate, with a speed uniform in [2.5, 5]. Observed every 0.1 for 20 time units,
    with Gaussian noise of 0.02 in every state. Working values: the conservative kernel
    fit of `pinav.fitting.fit_bayes` finds the force to about 0.1 % on visited ground
    and around it. Default: 8 trajectories.
    """
    return planar_system("barrier-crossings", paper_swimmer(), RING)


@with_random_starts
def swirl() -> System:
    r"""The paper's barrier and a swirl beside it: a force without a potential.

    The swirl has strength $S = 3$, width 2.5 and centre (6, 4). Over the whole plane
    the rotational fraction of the squared force is $S^2 / (S^2 + U_0^2) = 0.246$.
    Starts, times and noise are those of `barrier_crossings`. Expected: a potential
    cannot explain the data; swimmers are turned counter-clockwise about the swirl.
    Default: 16 trajectories.
    """
    rotation = gaussian_swirl(strength=3.0, center=[6.0, 4.0], width=2.5)
    truth = paper_swimmer(SumForce((paper_barrier(), rotation)))
    return planar_system("swirl", truth, MANY)


@with_random_starts
def moving_barrier() -> System:
    r"""The paper's barrier on a circle of radius 2 about (5, 5), once in 20 time units.

    Starts, times and noise are those of `barrier_crossings`. Expected: a static force
    cannot explain the data, because the same place pushes first one way, then another.
    Default: 16 trajectories.
    """
    motion = CircularMotion(radius=2.0, frequency=2 * np.pi / 20)
    truth = paper_swimmer(Moving(paper_barrier(), motion))
    return planar_system("moving-barrier", truth, MANY)


SQUARE = Domain((0.0, 0.0), (20.0, 20.0))
"""Box of centres and starts."""

COASTING = CoastingStarts(lower=SQUARE.lower, upper=SQUARE.upper, damping=DAMPING)

FIELD_SEED = 12
"""Each field is drawn once: keys of a scenario change its starts, not its world."""


@with_random_starts
def many_barriers() -> System:
    """Twelve barriers of random height and width, at places that keep apart.

    Heights are uniform in [1, 3], widths in [1, 1.6]; the field is the same for every
    key. Starts are uniform on the square, with the velocity that drag alone would bring
    to rest at a uniform target: the median speed is 3.5, enough to climb most barriers.
    Thrust, drag and observation are those of `barrier_crossings`. Expected: swimmers
    are deflected several times, slow ones settle between the barriers and drift upwards
    with the thrust. Default: 32 trajectories.
    """
    field = random_barriers(
        SQUARE,
        12,
        heights=(1.0, 3.0),
        widths=(1.0, 1.6),
        key=jax.random.key(FIELD_SEED),
    )
    return planar_system("many-barriers", paper_swimmer(field), COASTING)


@with_random_starts
def fibres() -> System:
    """Twelve fibres in random directions: ridges of length 2.5 and width 0.7.

    Heights are uniform in [1, 3]; the field is the same for every key. Starts, thrust,
    drag and observation are those of `many_barriers`. Expected: swimmers are reflected
    by the flanks of the ridges and slip past their ends. Default: 32 trajectories.
    """
    field = random_fibres(
        SQUARE,
        12,
        heights=(1.0, 3.0),
        length=2.5,
        width=0.7,
        key=jax.random.key(FIELD_SEED),
    )
    return planar_system("fibres", paper_swimmer(field), COASTING)


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
