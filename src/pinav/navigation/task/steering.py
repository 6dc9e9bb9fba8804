r"""Swimmers that take commands: rotation frequency and direction.

A command is held from one control step to the next. It is the frequency f of the
rotating field [cycles T⁻¹] and the direction of the normal of the plane in which the
field rotates: in the plane its heading $\theta$ [rad], the angle to the x axis; in
space the heading of its projection on the xy plane, and its elevation $\epsilon$ [rad]
above it.
"""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.actuation import AbstractActuator as AbstractActuator
from pinav.actuation import Command as Command
from pinav.actuation import RollingActuator as RollingActuator
from pinav.actuation import direction as direction
from pinav.arguments import Scalar, State, Vector, check_positive
from pinav.dynamics import AbstractSwimmer
from pinav.forces import AbstractForce


def direction_angles(vector: Vector) -> Float[Array, " angle"]:
    """Heading, and in space elevation, of a vector that is not zero [rad]."""
    heading = jnp.arctan2(vector[1], vector[0])
    if vector.shape[0] == 2:
        return heading[None]
    across = jnp.sqrt(vector[0] ** 2 + vector[1] ** 2 + TINY)
    return jnp.stack([heading, jnp.arctan2(vector[2], across)])


TINY = 1e-24
"""What keeps the elevation of a vertical direction differentiable [L²]."""


def all_directions(count: int, dim: int) -> Float[np.ndarray, "{count} {dim}"]:
    r"""Unit vectors all around, equally spaced in the plane and nearly so in space.

    In space they lie on a spiral from pole to pole, each at the golden angle from the
    one before.

    References:
        Gonzalez, Math. Geosci. 42, 49 (2010), for the lattice of the spiral.
    """
    places = np.arange(count)
    if dim == 2:
        angles = 2 * np.pi * places / count
        return np.stack([np.cos(angles), np.sin(angles)], axis=1)
    height = 1 - (2 * places + 1) / count
    angles = np.pi * (3 - np.sqrt(5.0)) * places
    across = np.sqrt(1 - height**2)
    return np.stack([across * np.cos(angles), across * np.sin(angles), height], axis=1)


class HeldThrust(AbstractForce):
    """A thrust that holds: what a command is until the next one."""

    thrust: Vector

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.thrust.astype(x.dtype)


class SteeredSwimmer(eqx.Module):
    """A swimmer whose propulsion follows commands.

    The truth, the fitted model and physics alone are one class with other dynamics.

    Attributes:
        dynamics: drag or mobility, environment and flow; commands replace its
            propulsion.
    """

    dynamics: AbstractSwimmer
    actuator: AbstractActuator

    def __call__(self, t: Scalar, y: State, command: Command) -> State:
        """Rate of change of the state `y` at time `t` [T] under a command."""
        return self.under(command)(t, y)

    def under(self, command: Command) -> AbstractSwimmer:
        """The dynamics while a command holds."""
        return with_thrust(self.dynamics, self.actuator(command))


def with_thrust(dynamics: AbstractSwimmer, thrust: Vector) -> AbstractSwimmer:
    """The dynamics with a thrust that holds as their propulsion."""
    # Not tree_at: the replaced propulsion may hold leaves under several names.
    return dataclasses.replace(dynamics, propulsion=HeldThrust(thrust))


@eqx.filter_jit
def thrusts_of(
    actuator: AbstractActuator, commands: Float[Array, "command dim"]
) -> Float[Array, "command dim"]:
    """Thrust of each of some commands [L T⁻²], by a compiled program."""
    return jax.vmap(actuator)(commands)


def greatest_thrust(
    actuator: AbstractActuator, limits: "CommandLimits", dim: int = 2
) -> Float[Array, ""]:
    """Size of the thrust at the greatest frequency [L T⁻²], along x."""
    command = jnp.zeros(dim).at[0].set(limits.max_frequency)
    return jnp.linalg.norm(actuator(command))


class CommandLimits(eqx.Module):
    """Limits of coils and robot.

    Attributes:
        max_frequency: greatest frequency [cycles T⁻¹], positive.
        max_turning_rate: greatest rate at which the direction turns [rad T⁻¹],
            positive; infinite means that coils turn at once.

    Raises:
        InputError: a limit is not positive.
    """

    max_frequency: float
    max_turning_rate: float = math.inf

    def __check_init__(self) -> None:
        check_positive(self, "max_frequency", "max_turning_rate")

    def clip(self, command: Command, previous: Command, duration: Scalar) -> Command:
        """The nearest allowed command after `previous` has held for `duration` [T]."""
        frequency = jnp.clip(command[0], 0.0, self.max_frequency)
        most = jnp.asarray(self.max_turning_rate * duration)
        angles = turned_angles(previous[1:], command[1:], most)
        return jnp.concatenate([frequency[None], angles])


def turned_angles(
    before: Float[Array, " angle"], wanted: Float[Array, " angle"], most: Scalar
) -> Float[Array, " angle"]:
    """Angles after a turn by at most `most` [rad], the short way: on a great circle."""
    if before.shape[0] == 1:
        turn = jnp.mod(wanted - before + math.pi, 2 * math.pi) - math.pi
        return before + jnp.clip(turn, -most, most)
    start, end = direction(before), direction(wanted)
    across = end - (end @ start) * start
    size = jnp.sqrt(across @ across + TINY)
    turn = jnp.minimum(jnp.arctan2(size, end @ start), most)
    return direction_angles(jnp.cos(turn) * start + jnp.sin(turn) * across / size)


def physics_only(model: SteeredSwimmer) -> SteeredSwimmer:
    """The model without its environment."""
    return SteeredSwimmer(model.dynamics.without_environment(), model.actuator)
