r"""What controllers predict with: a model, its table, or either with a drift."""

import abc
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Planar, Scalar, State
from pinav.errors import InputError
from pinav.navigation.model.tables import FieldTable
from pinav.navigation.task.steering import (
    AbstractActuator,
    Command,
    CommandLimits,
    SteeredSwimmer,
    direction,
)


class AbstractPredictor(eqx.Module):
    """Where the swimmer will be."""

    @abc.abstractmethod
    def step(self, t: Scalar, y: State, command: Command, duration: Scalar) -> State:
        """State after a command was held for `duration` [T] from time `t` [T]."""


class SwimmerPredictor(AbstractPredictor):
    """A model itself, by a Runge-Kutta step.

    Attributes:
        swimmer: the model.
    """

    swimmer: SteeredSwimmer

    def step(self, t: Scalar, y: State, command: Command, duration: Scalar) -> State:
        return self.swimmer.step(t, y, command, duration)


class InertialTable(AbstractPredictor):
    r"""A swimmer with inertia, from the table of its model; state (x, v).

    One look-up for a step, in its middle: half of the way at the old velocity, the
    implicit midpoint rule for the drag, half of the way at the new velocity. It is of
    second order, and stable whatever the drag.

    Attributes:
        table: acceleration at rest [L T⁻²] and drag [T⁻¹], of `tabulate`.
        actuator: what a command does.
    """

    table: FieldTable
    actuator: AbstractActuator

    def step(self, t: Scalar, y: State, command: Command, duration: Scalar) -> State:
        half = jnp.asarray(duration, y.dtype) / 2
        x, v = y[:2] + half * y[2:], y[2:]
        rates = self.table(jnp.asarray(t, y.dtype) + half, x)
        drag = rates[2:].reshape(2, 2)
        push = rates[:2] + self.actuator(command) - drag @ v
        implicit = jnp.eye(2, dtype=y.dtype) + half * drag
        v = v + 2 * half * _solve(implicit, push)
        return jnp.concatenate([x + half * v, v])


class OverdampedTable(AbstractPredictor):
    r"""A swimmer without inertia, from the table of its model, by the midpoint rule.

    Attributes:
        table: velocity without thrust [L T⁻¹] and mobility, of `tabulate`.
        actuator: what a command does.
    """

    table: FieldTable
    actuator: AbstractActuator

    def step(self, t: Scalar, y: State, command: Command, duration: Scalar) -> State:
        t, duration = jnp.asarray(t, y.dtype), jnp.asarray(duration, y.dtype)
        thrust = self.actuator(command)
        middle = y + duration / 2 * self._velocity(t, y, thrust)
        return y + duration * self._velocity(t + duration / 2, middle, thrust)

    def _velocity(self, t: Scalar, x: Planar, thrust: Planar) -> Planar:
        rates = self.table(t, x)
        return rates[:2] + rates[2:].reshape(2, 2) @ thrust


class Drifting(AbstractPredictor):
    r"""Another predictor, and a constant rate that it does not know.

    The rate b is the last pair of the state: (x, b) or (x, v, b). It adds to the
    velocity [L T⁻¹], or to the acceleration [L T⁻²] where there is one: half of it
    before the step of the other predictor and half after, which is of second order.

    Attributes:
        predictor: what is known.
    """

    predictor: AbstractPredictor

    def step(self, t: Scalar, y: State, command: Command, duration: Scalar) -> State:
        state, drift = y[:-2], y[-2:]
        half = jnp.asarray(duration, y.dtype) / 2 * drift
        state = state.at[-2:].add(half)
        state = self.predictor.step(t, state, command, duration).at[-2:].add(half)
        return jnp.concatenate([state, drift])


class ControlMap(eqx.Module):
    r"""Commands as controls: vectors in the unit disc, in units of the greatest thrust.

    A vector w stands for the frequency $|w| f_b$ in its own direction, where $f_b$ is
    the allowed frequency of the greatest thrust.

    Attributes:
        frequency: $f_b$ [cycles T⁻¹].
        limits: what may be commanded.
        actuator: what a command does.
    """

    frequency: float
    limits: CommandLimits
    actuator: AbstractActuator

    @classmethod
    def of(cls, actuator: AbstractActuator, limits: CommandLimits) -> "ControlMap":
        """The drive of an actuator within limits.

        Raises:
            InputError: no allowed command gives thrust.
        """
        frequencies = np.linspace(0.0, limits.max_frequency, 513)
        commands = jnp.stack([jnp.asarray(frequencies), jnp.zeros(513)], axis=1)
        thrusts = np.linalg.norm(np.asarray(jax.vmap(actuator)(commands)), axis=1)
        best = int(np.argmax(thrusts))
        if not thrusts[best] > 0:
            raise InputError(
                f"limits: expected a frequency that gives thrust, got none up to "
                f"{limits.max_frequency}; raise max_frequency"
            )
        return cls(float(frequencies[best]), limits, actuator)

    def command(self, control: Planar, previous: Command, duration: Scalar) -> Command:
        """The allowed command for a control, `duration` [T] after the previous one."""
        length = jnp.sqrt(control @ control + 1e-12)
        idle = control @ control < 1e-12  # where the heading has no derivative
        turned = jnp.arctan2(
            jnp.where(idle, 0.0, control[1]), jnp.where(idle, 1.0, control[0])
        )
        heading = jnp.where(idle, previous[1], turned)
        command = jnp.stack([jnp.minimum(length, 1.0) * self.frequency, heading])
        if math.isinf(self.limits.max_turning_rate):
            return command
        return self.limits.clip(command, previous, duration)

    def thrusts(self, count: int) -> Float[Array, "{count} 2"]:
        """Greatest thrust [L T⁻²] in `count` equally spaced headings."""
        headings = jnp.linspace(0.0, 2 * math.pi, count, endpoint=False)
        ahead = jnp.full_like(headings, self.frequency)
        return jax.vmap(self.actuator)(jnp.stack([ahead, headings], axis=1))

    def controls(self, count: int) -> Float[Array, "{count} 2"]:
        """Equally spaced directions of the greatest thrust."""
        headings = jnp.linspace(0.0, 2 * math.pi, count, endpoint=False)
        return jax.vmap(direction)(headings)


def within_disc(controls: Float[Array, "*many 2"]) -> Float[Array, "*many 2"]:
    """Vectors, those that are longer than one shortened to it."""
    length = jnp.sqrt(jnp.sum(controls**2, axis=-1, keepdims=True) + 1e-12)
    return controls / jnp.maximum(length, 1.0)


def _solve(matrix: Float[Array, "2 2"], vector: Planar) -> Planar:
    """Solution of two linear equations."""
    a, b, c, d = matrix[0, 0], matrix[0, 1], matrix[1, 0], matrix[1, 1]
    x, y = vector[0], vector[1]
    return jnp.stack([d * x - b * y, a * y - c * x]) / (a * d - b * c)
