"""Thermal motion: over a barrier, above a wall, and driven round a ring."""

import math

import jax.numpy as jnp
import numpy as np

from pinav.actuation import RotatingField
from pinav.dynamics import OverdampedSwimmer, thermal_energy
from pinav.forces import (
    ConstantForce,
    DoubleLayer,
    GaussianBarrier,
    MagneticPropulsion,
    Plane,
    PlaneWaves,
    WallMobility,
    Weight,
    ZeroForce,
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


RADIUS, VISCOSITY, TEMPERATURE = 1.0, 0.89, 298.15
"""A bead of 1 um in water at 25 degrees: [um], [mPa s], [K]."""

CRUISING_SPEED = 1.0
"""Speed without obstacles [um/s]."""


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
    heat, drag = thermal_energy(TEMPERATURE), stokes_drag(RADIUS, VISCOSITY)
    swimmer = OverdampedSwimmer(
        environment=ZeroForce(),
        propulsion=MagneticPropulsion(
            field=RotatingField(amplitude=1.0, frequency=2 * np.pi),
            moment=[0.0, 0.0, 1.0],
            gain=drag * CRUISING_SPEED,
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
