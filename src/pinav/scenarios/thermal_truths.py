"""Thermal motion whose law is known: above a wall, and driven round a ring."""

import math

import jax.numpy as jnp

from pinav.dynamics import OverdampedSwimmer, thermal_energy
from pinav.forces import (
    ConstantForce,
    DoubleLayer,
    Plane,
    PlaneWaves,
    WallMobility,
    Weight,
    ZeroForce,
)
from pinav.scenarios.random_starts import with_random_starts
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
    what its divergence adds to the drift is several times the weight.

    It has 10 trajectories unless another number is given.
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
"""Of the ring [um]."""


@with_random_starts
def ring() -> System:
    r"""A bead of 1 um driven round a ring of radius 4.12 um: a steady current.

    One coordinate, the arc x [um], unwrapped; the force has the period of the ring,
    25.9 um. It is a constant 0.053 pN and a wave of 0.050 pN, so that the bead all but
    waits where the two cancel. D = 0.273 um²/s; 150 frames a second for 67 s, an
    exposure of 4 ms and an error of 12 nm (3 mrad). Expected: the density varies by a
    factor of about 40 round the ring, a bead goes round once in some 22 s, and no
    potential has this force.

    It has 39 trajectories unless another number is given.
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
