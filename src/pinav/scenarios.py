"""Named true systems with their starts, times and noise."""

import equinox as eqx
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


SCENARIOS = {"paper": paper}
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
