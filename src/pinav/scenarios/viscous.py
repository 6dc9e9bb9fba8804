r"""Swimmers without inertia: beads in thermal motion, vessels and a box in space.

In space the thrust n is known and turns from one direction to the next, so that each
trajectory sees much of it: $\dot x = n(t) + F_e(x) + F_k(x)$; there is one schedule for
all trajectories, and the starts differ. Above the wall and in vessels lengths are in
um, forces in pN. The swimmer is a sphere of radius 5 um in water, which
a force drags; its thermal motion, 0.3 um in a second, is left out of the recordings and
belongs into the noise of a task.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pinav.actuation import RotatingField
from pinav.dynamics import OverdampedSwimmer, thermal_energy
from pinav.forces import (
    AbstractFlow,
    AbstractForce,
    Bifurcation,
    BifurcationFlow,
    ConstantForce,
    Domain,
    DoubleLayer,
    GaussianBarrier,
    HarmonicTrap,
    LinearForce,
    MagneticPropulsion,
    Plane,
    PlaneWaves,
    ScheduledThrust,
    Superposition,
    Tube,
    TubeFlow,
    WallMobility,
    Weight,
    ZeroForce,
    random_barriers,
    stokes_drag,
)
from pinav.scenarios.catalogue import with_random_starts
from pinav.systems import Observation, System, UniformStarts, Units

UNITS = Units("um", "s", "pN")


@with_random_starts
def wall() -> System:
    r"""A bead of 1.516 um above a wall at z = 0, held there by its weight.

    Its mobility is that near a plane wall; its weight of 7.2 fN (50 kg/m3 above water)
    and a double layer of 17 $k_B T$ and 26 nm hold it some 0.1 to 2 um above the wall.
    z is the height of its centre. Far from the wall D = 0.142 um²/s (1 mPa s, 21
    degrees). 60 frames a second for 50 s, an exposure of 6 ms and an error of 5 nm.
    Expected: at a gap of 0.17 um D normal to the wall is a tenth of that far away, and
    what its divergence adds to the drift is several times the weight. Default: 10
    trajectories.
    """
    heat, radius, viscosity = thermal_energy(294.15), 1.516, 1.0
    plane = Plane([0.0, 0.0, 1.0])
    layer = DoubleLayer(17 * heat, 0.026, radius, plane)
    return System(
        name="wall",
        swimmer=OverdampedSwimmer(
            ZeroForce(), ZeroForce(), WallMobility(radius, viscosity, plane)
        ),
        dim=3,
        environment=layer + Weight(radius, 50.0, [0.0, 0.0, -1.0]),
        thermal_energy=heat,
        observation=Observation(noise=0.005, exposure=0.006),
        rule=UniformStarts(
            lower=(0.0, 0.0, radius + 0.2), upper=(1.0, 1.0, radius + 1.0), count=10
        ),
        times=jnp.arange(3001) / 60,
        base_units=UNITS,
    )


CIRCUMFERENCE = 2 * math.pi * 4.12
"""Circumference of the ring [um]."""


@with_random_starts
def ring() -> System:
    r"""A bead of 1 um driven round a ring of radius 4.12 um: a steady current.

    One coordinate, the arc x [um], unwrapped; the force has the period of the ring,
    25.9 um. It is a constant 0.053 pN and a wave of 0.050 pN, so that the bead all but
    waits where the two cancel. D = 0.273 um²/s; 150 frames a second for 67 s, an
    exposure of 4 ms and an error of 12 nm (3 mrad). Expected: the density varies by a
    factor of about 40 round the ring, a bead goes round once in some 22 s, and no
    potential has this force. Default: 39 trajectories.
    """
    heat = thermal_energy(293.15)
    drag = heat / 0.273
    turns = 2 * math.pi / CIRCUMFERENCE
    wave = PlaneWaves([0.050 / turns], [[turns]], [0.0])
    return System(
        name="ring",
        swimmer=OverdampedSwimmer(ZeroForce(), ZeroForce(), 1 / drag),
        dim=1,
        environment=ConstantForce([0.053]) + wave,
        thermal_energy=heat,
        observation=Observation(noise=0.012, exposure=0.004),
        rule=UniformStarts(lower=(0.0,), upper=(CIRCUMFERENCE,), count=39),
        times=jnp.arange(10_001) / 150,
        base_units=UNITS,
    )


@with_random_starts
def brownian() -> System:
    r"""A bead of 1 um in water, driven over a low barrier, in um, s and pN.

    Drag $\gamma$ = 1.68e-2 pN s/um (1.68e-8 N s/m), $k_B T$ = 4.12e-3 pN um and by the
    fluctuation-dissipation relation $D = k_B T / \gamma$ = 0.245 um²/s. The thrust of
    $\gamma$ times 1 um/s = 0.0168 pN points along y; the barrier at the origin has a
    height of 0.0823 pN um = 20 $k_B T$ and a width of 2 um, so that it pushes with at
    most 0.025 pN: more than the thrust, and a swimmer that meets it head on is turned
    aside. Starts are uniform in a box of 12 by 10 um below and around it; 24 frames a
    second for 10 s, no localisation error. The key of `simulate` draws the paths.
    Expected: the squared displacement of a frame is mostly diffusion, 4 D / 24 = 0.041
    um², against 0.002 um² of drift. Default: 32 trajectories.
    """
    heat, drag = thermal_energy(298.15), stokes_drag(radius=1.0, viscosity=0.89)
    swimmer = OverdampedSwimmer(
        environment=ZeroForce(),
        propulsion=MagneticPropulsion(
            field=RotatingField(amplitude=1.0, frequency=2 * np.pi),
            moment=[0.0, 0.0, 1.0],
            gain=drag,  # at 1 um/s
            axis=[0.0, 1.0],
        ),
        mobility=1 / drag,
    )
    return System(
        name="brownian",
        swimmer=swimmer,
        dim=2,
        environment=GaussianBarrier(height=20 * heat, center=[0.0, 0.0], width=2.0),
        thermal_energy=heat,
        rule=UniformStarts(lower=(-6.0, -8.0), upper=(6.0, 2.0), count=32),
        times=jnp.linspace(0.0, 10.0, 241),
        base_units=UNITS,
    )


RADIUS, VISCOSITY, EXCESS_DENSITY = 5.0, 1.0, 20.0
"""Radius [um], viscosity of water [mPa s], excess density of the sphere [kg m⁻³]."""

FIELD_SEED = 2
"""The field is drawn once: keys of the scenario change its starts, not its world."""


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


@with_random_starts
def above_wall() -> System:
    r"""A heavy swimmer above a wall at z = 0, among eight unknown soft posts.

    Its mobility is that of a sphere near a plane; its weight of 0.10 pN and the
    repulsion by the wall, of 5 pN um and 1 um, are known, as is a trap of 0.01 pN/um
    along x and y, which keeps it above a square of 100 um. The posts are Gaussian
    barriers of 15 to 25 pN um and widths of 11 to 14 um, their centres up to 20 um
    high: the steepest push with up to 1.3 pN. A force of 2 pN drags it out and back
    along one direction after the other, for 1.5 s each way; more across than up and
    down. Observed every 0.25 s for 45 s, with an error of 0.2 um. Expected: it sinks by
    1.1 um/s far from the wall, and at a gap of a radius rises at 0.4 and slides at 0.7
    of the speed far away. Default: 16 trajectories.
    """
    floor = Plane([0.0, 0.0, 1.0])
    posts = random_barriers(
        Domain((10.0, 10.0, 5.0), (90.0, 90.0, 20.0)),
        8,
        heights=(15.0, 25.0),
        widths=(11.0, 14.0),
        key=jax.random.key(FIELD_SEED),
    )
    trap = LinearForce(-0.01 * jnp.diag(jnp.array([1.0, 1.0, 0.0])), [50.0, 50.0, 0.0])
    weight = Weight(RADIUS, EXCESS_DENSITY, [0.0, 0.0, -1.0])
    return System(
        name="above-wall",
        swimmer=OverdampedSwimmer(
            out_and_back(45.0, 1.5, 2.0, steep=0.5),
            ZeroForce(),
            WallMobility(RADIUS, VISCOSITY, floor),
            known_force=weight + DoubleLayer(5.0, 1.0, RADIUS, floor) + trap,
        ),
        dim=3,
        environment=posts,
        observation=Observation(noise=0.2),
        rule=UniformStarts(lower=(0.0, 0.0, 8.0), upper=(100.0, 100.0, 35.0), count=16),
        times=jnp.linspace(0.0, 45.0, 181),
        base_units=UNITS,
    )


@with_random_starts
def tube() -> System:
    r"""A swimmer in a tube along x of radius 40 um, with soft plaques on its wall.

    The fluid flows along +x, 4 um/s on the axis in the mean and half as much more and
    less every 7.5 s, as lymph does. The mobility is that near the wall, which repels as
    that of `above_wall` does; the swimmer has no weight here. All that is known. Three
    plaques, Gaussian barriers of 18 to 22 pN um and 15 to 17 um near the wall, are not:
    the steepest push with up to 0.8 pN. A force of 2 pN drags the swimmer out and back
    for 1 s each way. Observed every 0.2 s for 15 s, with an error of 0.2 um. Expected:
    near the wall both flow and mobility are less. Default: 16 trajectories.
    """
    vessel = Tube([1.0, 0.0, 0.0], [0.0, 0.0, 0.0], 40.0)
    plaques = Superposition(
        eqx.filter_vmap(GaussianBarrier)(
            jnp.array([22.0, 20.0, 18.0]),
            jnp.array([[30.0, 20.0, 6.0], [62.0, -16.0, 14.0], [90.0, 4.0, -22.0]]),
            jnp.array([17.0, 16.0, 15.0]),
        )
    )
    flow = TubeFlow(4.0, vessel, pulse=0.5, frequency=1 / 7.5)
    return _vessel("tube", vessel, flow, plaques, (110.0, 22.0, 22.0))


@with_random_starts
def bifurcation() -> System:
    r"""A swimmer in a vessel that parts into two, with soft plaques at the fork.

    The trunk along x has a radius of 40 um; at x = 60 um it parts into two tubes of 32
    um, 30 degrees to either side, as Murray's law has it for equal ones. The fluid
    flows out of the trunk, 4 um/s on its axis in the mean and half as much more and
    less every 7.5 s; 35 % of it go into the tube of y > 0. The swimmer, its mobility
    and the repulsion by the wall are those of `tube`. All that is known. Three plaques,
    Gaussian barriers of 16 to 20 pN um and 13 to 15 um, one of them in the mouth of the
    tube of y > 0, are not. A force of 2 pN drags the swimmer out and back for 1 s each
    way. Observed every 0.2 s for 15 s, with an error of 0.2 um. Expected: most swimmers
    are carried into one of the tubes, more of them into that of y < 0. Default: 16
    trajectories.
    """
    turn = jnp.pi / 6
    upper = jnp.array([jnp.cos(turn), jnp.sin(turn), 0.0])
    lower = upper * jnp.array([1.0, -1.0, 1.0])
    vessel = Bifurcation(
        [60.0, 0.0, 0.0],
        jnp.stack([jnp.array([-1.0, 0.0, 0.0]), upper, lower]),
        jnp.array([40.0, 32.0, 32.0]),
    )
    plaques = Superposition(
        eqx.filter_vmap(GaussianBarrier)(
            jnp.array([18.0, 20.0, 16.0]),
            jnp.array([[30.0, -18.0, 8.0], [76.0, 20.0, 4.0], [92.0, -22.0, -10.0]]),
            jnp.array([15.0, 13.0, 14.0]),
        )
    )
    flow = BifurcationFlow(
        4.0, vessel, jnp.array([0.35, 0.65]), pulse=0.5, frequency=1 / 7.5
    )
    return _vessel("bifurcation", vessel, flow, plaques, (100.0, 22.0, 16.0))


def _vessel(
    name: str,
    vessel: Tube | Bifurcation,
    flow: AbstractFlow,
    plaques: AbstractForce,
    corner: tuple[float, float, float],
) -> System:
    """A sphere dragged through a vessel, from starts about the axis up to a corner."""
    return System(
        name=name,
        swimmer=OverdampedSwimmer(
            out_and_back(15.0, 1.0, 2.0),
            ZeroForce(),
            WallMobility(RADIUS, VISCOSITY, vessel),
            flow=flow,
            known_force=DoubleLayer(5.0, 1.0, RADIUS, vessel),
        ),
        dim=3,
        environment=plaques,
        observation=Observation(noise=0.2),
        rule=UniformStarts(lower=(0.0, -corner[1], -corner[2]), upper=corner, count=16),
        times=jnp.linspace(0.0, 15.0, 76),
        base_units=UNITS,
    )


BOX = Domain((0.0, 0.0, 0.0), (10.0, 10.0, 10.0))
"""Box of the obstacles' centres and of the starts."""


@with_random_starts
def box() -> System:
    """Twelve soft obstacles in a box of 10 by 10 by 10, which a swimmer goes round.

    Gaussian barriers that keep apart, of heights uniform in [2, 4] and widths in [1.6,
    2]: the steepest push with up to 1.3. The field is the same for every key. A known
    trap of stiffness 0.1 about the middle, such as that of a standing wave of sound,
    keeps swimmers in the box. Starts are uniform in the box; a thrust of 2 drives them
    out and back along one direction after the other, for a time unit each way. Observed
    every 0.2 for 30 time units, with an error of 0.02. Expected: each swimmer sees the
    space about its start and slides off the obstacles there. Default: 16 trajectories.
    """
    field = random_barriers(
        BOX, 12, heights=(2.0, 4.0), widths=(1.6, 2.0), key=jax.random.key(12)
    )
    return System(
        name="box",
        swimmer=OverdampedSwimmer(
            out_and_back(30.0, 1.0, 2.0),
            ZeroForce(),
            1.0,
            known_force=HarmonicTrap(stiffness=0.1, center=[5.0, 5.0, 5.0]),
        ),
        dim=3,
        environment=field,
        observation=Observation(noise=0.02),
        rule=UniformStarts(lower=BOX.lower, upper=BOX.upper, count=16),
        times=jnp.linspace(0.0, 30.0, 151),
    )
