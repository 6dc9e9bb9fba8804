"""A real swimmer: first order, thermal noise, SI values in um, s and pN."""

import jax.numpy as jnp
import numpy as np

from pinav.actuation import RotatingField
from pinav.dynamics import OverdampedSwimmer, thermal_energy
from pinav.forces import GaussianBarrier, MagneticPropulsion, ZeroForce, stokes_drag
from pinav.scenarios.random_starts import with_random_starts
from pinav.systems import System, UniformStarts, Units

RADIUS, VISCOSITY, TEMPERATURE = 1.0, 0.89, 298.15
"""A bead of 1 um in water at 25 degrees: [um], [mPa s], [K]."""

CRUISING_SPEED = 1.0
"""Speed without obstacles [um/s]."""


@with_random_starts
def brownian() -> System:
    r"""A bead of 1 um in water, driven over a low barrier, in um, s and pN.

    Drag $\gamma$ = 1.68e-2 pN s/um (1.68e-8 N s/m), $k_B T$ = 4.12e-3 pN um and by
    the fluctuation-dissipation relation $D = k_B T / \gamma$ = 0.245 um²/s. The thrust
    of $\gamma$ times 1 um/s = 0.0168 pN points along y; the barrier at the origin has a
    height of 0.0823 pN um = 20 $k_B T$ and a width of 2 um, so that it pushes with at
    most 0.025 pN: more than the thrust, and a swimmer that meets it head on is turned
    aside. Starts are uniform in a box of 12 by 10 um below and around it; 24 frames a
    second for 10 s, no localisation error. The key of `simulate` draws the paths.
    Expected: the squared displacement of a frame is mostly diffusion, 4 D / 24 =
    0.041 um², against 0.002 um² of drift.

    It has 32 trajectories unless another number is given.
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
        environment=GaussianBarrier(20 * heat, [0.0, 0.0], 2.0),
        thermal_energy=heat,
        rule=UniformStarts(lower=(-6.0, -8.0), upper=(6.0, 2.0), count=32),
        times=jnp.linspace(0.0, 10.0, 241),
        base_units=Units("um", "s", "pN"),
    )
