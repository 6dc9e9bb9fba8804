"""What a scenario is, and how its random starts are drawn."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from pinav.dynamics import AbstractDynamics, BrownianSwimmer, OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.forces import Domain


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
    truth: AbstractDynamics
    starts: Float[Array, "trajectory state"]
    times: Float[Array, " time"]
    noise: float
    channels: tuple[str, ...] = eqx.field(static=True)
    units: dict[str, str]

    @property
    def swimmer(self) -> Swimmer | OverdampedSwimmer:
        """The truth without what thermal noise adds: propulsion and drag are known.

        Raises:
            InputError: the truth is no swimmer.
        """
        truth = self.truth
        found = truth.swimmer if isinstance(truth, BrownianSwimmer) else truth
        if not isinstance(found, Swimmer | OverdampedSwimmer):
            raise InputError(
                f"scenario {self.name!r}: expected a swimmer, got "
                f"{type(self.truth).__name__}; choose another scenario"
            )
        return found


PLANAR_CHANNELS = ("x", "y", "vx", "vy")
DIMENSIONLESS: dict[str, str] = dict.fromkeys((*PLANAR_CHANNELS, "t"), "1")


def planar_scenario(
    name: str,
    truth: Swimmer,
    starts: Float[Array, "trajectory 4"],
    *,
    until: float = 20.0,
    noise: float = 0.02,
) -> Scenario:
    """A dimensionless scenario in the plane, observed every 0.1.

    Args:
        name: what the command line calls it.
        truth: the swimmer.
        starts: positions and velocities.
        until: last time of observation.
        noise: standard deviation of the observations.
    """
    return Scenario(
        name=name,
        truth=truth,
        starts=starts,
        times=jnp.linspace(0.0, until, round(10 * until) + 1),
        noise=noise,
        channels=PLANAR_CHANNELS,
        units=DIMENSIONLESS,
    )


def ring_starts(
    key: PRNGKeyArray | None, count: int | None, default: int = 8
) -> Float[Array, "trajectory 4"]:
    """Starts on the circle of radius 7 about (5, 5), aimed near its centre.

    Angles are uniform; the aim is the centre plus a normal offset of standard deviation
    2 in each coordinate; the speed is uniform in [2.5, 5].

    Args:
        key: random key; `jax.random.key(0)` unless given.
        count: number of starts; more of a key begin with the same ones.
        default: number of starts where `count` is not given.

    Raises:
        InputError: `count` is not positive.
    """
    count = _checked_count(count, default)
    angle_key, offset_key, speed_key = jax.random.split(_key(key), 3)
    center = jnp.array([[5.0, 5.0]])
    angles = jax.random.uniform(angle_key, (count,), maxval=2 * np.pi)
    positions = center + 7.0 * jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1)
    targets = center + 2.0 * jax.random.normal(offset_key, (count, 2))
    aims = targets - positions
    speeds = jax.random.uniform(speed_key, (count, 1), minval=2.5, maxval=5.0)
    velocities = speeds * aims / jnp.linalg.norm(aims, axis=1, keepdims=True)
    return jnp.concatenate([positions, velocities], axis=1)


def coasting_starts(
    domain: Domain,
    damping: float,
    *,
    key: PRNGKeyArray | None,
    count: int | None,
    default: int = 32,
) -> Float[Array, "trajectory 4"]:
    r"""Uniform starts, with the velocity that would coast to a uniform target.

    Drag alone brings a swimmer to rest after the way $v_0 / \eta$, so it starts with
    $v_0 = \eta (x_1 - x_0)$: fast where the way is long, and inside of the domain.

    Args:
        domain: holds starts and targets.
        damping: $\eta$ [T⁻¹].
        key: random key; `jax.random.key(0)` unless given.
        count: number of starts; more of a key begin with the same ones.
        default: number of starts where `count` is not given.

    Raises:
        InputError: `count` is not positive.
    """
    count = _checked_count(count, default)
    start_key, target_key = jax.random.split(_key(key))
    positions = domain.points(start_key, count)
    velocities = damping * (domain.points(target_key, count) - positions)
    return jnp.concatenate([positions, velocities], axis=1)


def uniform_starts(
    domain: Domain, *, key: PRNGKeyArray | None, count: int | None, default: int
) -> Float[Array, "trajectory 2"]:
    """Uniform positions, for swimmers without inertia.

    Args:
        domain: holds the starts.
        key: random key; `jax.random.key(0)` unless given.
        count: number of starts; more of a key begin with the same ones.
        default: number of starts where `count` is not given.

    Raises:
        InputError: `count` is not positive.
    """
    return domain.points(_key(key), _checked_count(count, default))


def _key(key: PRNGKeyArray | None) -> PRNGKeyArray:
    return jax.random.key(0) if key is None else key


def _checked_count(count: int | None, default: int) -> int:
    if count is not None and count < 1:
        raise InputError(f"scenario count: expected 1 or more, got {count}")
    return default if count is None else count
