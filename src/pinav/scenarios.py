"""Named true systems with their starts, times and noise."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from pinav.actuation import RotatingField
from pinav.dynamics import Swimmer
from pinav.errors import InputError
from pinav.forces import GaussianBarrier, LinearDrag, MagneticPropulsion


class Scenario(eqx.Module):
    """A true system, where it is started and when it is observed.

    Attributes:
        name: what the command line calls it.
        truth: the dynamics, with nothing unknown.
        starts: initial states, one per trajectory.
        times: observation times [T], the same for every trajectory.
        noise: standard deviation of the Gaussian observation noise, in each state.
        channels: names of the components of the state.
        units: unit of each channel and of time `t`; "1" means dimensionless.
    """

    name: str = eqx.field(static=True)
    truth: Swimmer
    starts: Float[Array, "trajectory state"]
    times: Float[Array, " time"]
    noise: float
    channels: tuple[str, ...] = eqx.field(static=True)
    units: dict[str, str]


PLANAR_CHANNELS = ("x", "y", "vx", "vy")
DIMENSIONLESS: dict[str, str] = dict.fromkeys((*PLANAR_CHANNELS, "t"), "1")


def paper(key: PRNGKeyArray | None = None) -> Scenario:
    r"""The paper's benchmark: shot at a Gaussian barrier, stalled, rolled off.

    The constants that the paper does not print are *identified*: the row
    "physics-only" of its Table 2 depends on them alone, and least squares on that
    row gives these values (one point of a family; docs/benchmark.md). The swimmer
    all but stalls near the top of the barrier at about 7 s, so the rest of the
    trajectory is very sensitive to the start: keep all digits.

    Args:
        key: unused; the scenario has a single fixed start and no noise.

    References:
        PI-NAV paper, eqs. (1)-(2), Table 1 and Table 2.
    """
    del key
    truth = Swimmer(
        propulsion=MagneticPropulsion(
            field=RotatingField(amplitude=1.0, frequency=2 * np.pi),
            moment=[0.0, 0.0, 1.0],
            gain=0.034,
            axis=[0.0, 1.0],
        ),
        drag=LinearDrag(damping=0.36),
        environment=GaussianBarrier(height=5.25, center=[5.0, 5.0], width=2.9),
    )
    return Scenario(
        name="paper",
        truth=truth,
        starts=jnp.array([[0.0, 0.0, 3.503477, 3.439507]]),
        times=jnp.linspace(0.0, 50.0, 501),
        noise=0.0,
        channels=PLANAR_CHANNELS,
        units=DIMENSIONLESS,
    )


def barrier_crossings(key: PRNGKeyArray | None = None) -> Scenario:
    r"""Eight noisy shots at the paper's barrier, from all around it.

    The swimmers start on the circle of radius 7 about the barrier's centre, at
    uniform angles, aimed at the centre plus a normal offset of standard deviation 2
    in each coordinate, with a speed uniform in [2.5, 5]. Observed every 0.1 for 20
    time units, with Gaussian noise of 0.02 in every state. Working values: the
    conservative kernel fit of `pinav.fitting.fit_bayes` finds the force to about 0.1 %
    on visited ground and around it.

    Args:
        key: random key of the starts; `jax.random.key(0)` unless given.
    """
    angle_key, offset_key, speed_key = jax.random.split(
        jax.random.key(0) if key is None else key, 3
    )
    center, count = jnp.array([[5.0, 5.0]]), 8
    angles = jax.random.uniform(angle_key, (count,), maxval=2 * np.pi)
    positions = center + 7.0 * jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1)
    targets = center + 2.0 * jax.random.normal(offset_key, (count, 2))
    aims = targets - positions
    speeds = jax.random.uniform(speed_key, (count, 1), minval=2.5, maxval=5.0)
    velocities = speeds * aims / jnp.linalg.norm(aims, axis=1, keepdims=True)
    return Scenario(
        name="barrier-crossings",
        truth=paper().truth,
        starts=jnp.concatenate([positions, velocities], axis=1),
        times=jnp.linspace(0.0, 20.0, 201),
        noise=0.02,
        channels=PLANAR_CHANNELS,
        units=DIMENSIONLESS,
    )


SCENARIOS = {"paper": paper, "barrier-crossings": barrier_crossings}
"""Named scenarios: each takes an optional random key and returns a `Scenario`."""


def scenario(name: str, key: PRNGKeyArray | None = None) -> Scenario:
    """The scenario of that name.

    Args:
        name: a key of `SCENARIOS`.
        key: random key of its starts, where they are random.

    Raises:
        InputError: no scenario has that name.
    """
    if name not in SCENARIOS:
        known = ", ".join(sorted(SCENARIOS))
        raise InputError(f"scenario {name!r} is unknown; choose one of: {known}")
    return SCENARIOS[name](key)
