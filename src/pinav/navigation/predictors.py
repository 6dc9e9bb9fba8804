r"""A model as tables and as a predictor: what plans and controllers work with."""

import abc
import dataclasses
import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar, State, Vector, on_device
from pinav.dynamics import Swimmer
from pinav.errors import InputError
from pinav.navigation import tables
from pinav.navigation.task.steering import (
    AbstractActuator,
    Command,
    CommandLimits,
    SteeredSwimmer,
    all_directions,
    direction_angles,
)
from pinav.navigation.task.task import AbstractZone, Rectangle, Task, clearance


class AbstractPredictor(eqx.Module):
    """The future state of a swimmer, by a model."""

    @abc.abstractmethod
    def step(self, t: Scalar, y: State, command: Command, duration: Scalar) -> State:
        """State after a command was held for `duration` [T] from time `t` [T]."""


class InertialTable(AbstractPredictor):
    r"""A swimmer with inertia, from the table of its model; state (x, v).

    One look-up for a step, in its middle: half of the way at the old velocity, the
    implicit midpoint rule for the drag, half of the way at the new velocity. It is of
    second order, and stable whatever the drag.

    Attributes:
        table: acceleration at rest [L T⁻²] and drag [T⁻¹], of `tabulate`.
    """

    table: tables.FieldTable
    actuator: AbstractActuator

    def step(self, t: Scalar, y: State, command: Command, duration: Scalar) -> State:
        half = jnp.asarray(duration, y.dtype) / 2
        x, v = jnp.split(y, 2)
        x = x + half * v
        force, drag = split_rates(self.table(jnp.asarray(t, y.dtype) + half, x))
        push = force + self.actuator(command) - drag @ v
        implicit = jnp.eye(x.shape[0], dtype=y.dtype) + half * drag
        v = v + 2 * half * _solve(implicit, push)
        return jnp.concatenate([x + half * v, v])


class OverdampedTable(AbstractPredictor):
    r"""A swimmer without inertia, from the table of its model, by the midpoint rule.

    The middle is found with values that are interpolated linearly, whose error of the
    second order in the spacing is multiplied by half of the step and by the gradient.

    Attributes:
        table: velocity without thrust [L T⁻¹] and mobility, of `tabulate`.
    """

    table: tables.FieldTable
    actuator: AbstractActuator

    def step(self, t: Scalar, y: State, command: Command, duration: Scalar) -> State:
        t, duration = jnp.asarray(t, y.dtype), jnp.asarray(duration, y.dtype)
        thrust = self.actuator(command)

        def velocity(rates: Float[Array, " channel"]) -> Vector:
            drift, mobility = split_rates(rates)
            return drift + mobility @ thrust

        # What the first look-up misses counts for half a step alone.
        middle = y + duration / 2 * velocity(self.table.interpolate_linearly(t, y))
        return y + duration * velocity(self.table(t + duration / 2, middle))


class ControlMap(eqx.Module):
    r"""Commands as controls: vectors in the unit ball, in units of the greatest thrust.

    A vector w stands for the frequency $|w| f_b$ in its own direction, where $f_b$ is
    the allowed frequency of the greatest thrust.

    Attributes:
        frequency: $f_b$ [cycles T⁻¹].
    """

    frequency: float
    limits: CommandLimits
    actuator: AbstractActuator
    dim: int = eqx.field(static=True, default=2)

    @classmethod
    def of(
        cls, actuator: AbstractActuator, limits: CommandLimits, dim: int = 2
    ) -> "ControlMap":
        """The drive of an actuator within limits, in the plane or in space.

        Raises:
            InputError: no allowed command gives thrust.
        """
        frequencies = np.linspace(0.0, limits.max_frequency, 513)
        commands = np.zeros((513, dim))
        commands[:, 0] = frequencies
        every = eqx.filter_jit(eqx.filter_vmap(actuator))(on_device(commands))
        thrusts = np.linalg.norm(np.asarray(every), axis=1)
        best = int(np.argmax(thrusts))
        if not thrusts[best] > 0:
            raise InputError(
                f"limits: expected a frequency that gives thrust, got none up to "
                f"{limits.max_frequency}; raise max_frequency"
            )
        return cls(float(frequencies[best]), limits, actuator, dim)

    def command(self, control: Vector, previous: Command, duration: Scalar) -> Command:
        """The allowed command for a control, `duration` [T] after the previous one."""
        length = jnp.sqrt(control @ control + 1e-12)
        idle = control @ control < 1e-12  # where the direction has no derivative
        along_x = jnp.eye(1, self.dim, dtype=control.dtype)[0]
        turned = direction_angles(jnp.where(idle, along_x, control))
        angles = jnp.where(idle, previous[1:], turned)
        frequency = jnp.minimum(length, 1.0) * self.frequency
        command = jnp.concatenate([frequency[None], angles])
        if math.isinf(self.limits.max_turning_rate):
            return command
        return self.limits.clip(command, previous, duration)

    @eqx.filter_jit
    def thrusts(self, count: int) -> Float[Array, "{count} dim"]:
        """Greatest thrust [L T⁻²] in `count` directions all around."""

        def thrust(control: Vector) -> Vector:
            angles = direction_angles(control)
            ahead = jnp.full((1,), self.frequency, control.dtype)
            return self.actuator(jnp.concatenate([ahead, angles]))

        return jax.vmap(thrust)(self.controls(count))

    def controls(self, count: int) -> Float[Array, "{count} dim"]:
        """Directions of the greatest thrust, spaced as equally as may be."""
        return jnp.asarray(all_directions(count, self.dim))


def split_rates(
    channels: Float[Array, "*many channel"],
) -> tuple[Float[Array, "*many dim"], Float[Array, "*many dim dim"]]:
    """The channels of `tabulate`: a rate, and the matrix of drag or mobility."""
    dim = math.isqrt(channels.shape[-1])  # dim and its square
    shape = (*channels.shape[:-1], dim, dim)
    return channels[..., :dim], channels[..., dim:].reshape(shape)


def within_ball(controls: Float[Array, "*many dim"]) -> Float[Array, "*many dim"]:
    """Vectors, those that are longer than one shortened to it."""
    length = jnp.sqrt(jnp.sum(controls**2, axis=-1, keepdims=True) + 1e-12)
    return controls / jnp.maximum(length, 1.0)


def _solve(matrix: Float[Array, "dim dim"], vector: Vector) -> Vector:
    """Solution of a few linear equations; of two by hand, which is quicker."""
    if vector.shape[0] > 2:
        return jnp.linalg.solve(matrix, vector)
    a, b, c, d = matrix[0, 0], matrix[0, 1], matrix[1, 0], matrix[1, 1]
    x, y = vector[0], vector[1]
    return jnp.stack([d * x - b * y, a * y - c * x]) / (a * d - b * c)


class TimeCost(eqx.Module):
    r"""Cost of a unit of time: 1, more near walls and where the model is uncertain.

    $$p(t, x) = 1 + k \max(0, 1 - c(x) / m)^2 + \rho\, (s(t, x) / u)^2,$$

    with the clearance c, the standard deviation s of the model's rate and the rate u
    that the greatest thrust gives.

    Attributes:
        margin: m, from a wall, over which time costs more [L], positive.
        steepness: k.
        spread: s / u, dimensionless; zeros where the model is taken for true.
        risk_aversion: $\rho$ to what is not known.
    """

    keep_out: tuple[AbstractZone, ...]
    arena: Rectangle
    margin: Scalar
    steepness: float
    spread: tables.FieldTable
    risk_aversion: Scalar

    def clearance(self, x: Vector) -> Float[Array, ""]:
        """Distance from the nearest forbidden place [L]."""
        return clearance(x, self.keep_out, self.arena)

    def running_cost(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        """Cost of a unit of time, at time `t` [T] and position `x` [L]."""
        return 1 + self.nearness(self.clearance(x)) + self.risk(t, x)

    def nearness(self, clearance: Float[Array, "*many"]) -> Float[Array, "*many"]:
        """Additional cost of time at this distance from forbidden places [L]."""
        lack = jnp.maximum(0.0, 1 - clearance / self.margin)
        return self.steepness * lack**2

    def risk(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        """Additional cost of time where the model is uncertain."""
        return self.risk_aversion * self.spread(t, x)[0] ** 2


def entry_fraction(
    x: Vector, displacement: Vector, goal: Vector, tolerance: Scalar
) -> Float[Array, ""]:
    """Fraction of a straight step after which it enters a ball; infinite if never."""
    offset = x - goal
    beyond = offset @ offset - jnp.asarray(tolerance, x.dtype) ** 2
    square = displacement @ displacement
    approach = -(offset @ displacement)
    inner = approach**2 - square * beyond
    meets = (inner > 0) & (approach > 0)
    root = jnp.sqrt(jnp.where(meets, inner, 1.0))
    fraction = (approach - root) / jnp.where(meets, square, 1.0)
    fraction = jnp.where(meets & (fraction <= 1), fraction, jnp.inf)
    return jnp.where(beyond <= 0, 0.0, fraction)


STEEPNESS = 4.0
"""Cost of time at a wall, beside that of time itself."""

RISK_AVERSION = 4.0
"""The same where the spread of a model is as great as the thrust."""

HEADINGS = 24
"""Directions in which the greatest thrust is looked for."""


class TabulatedModel(eqx.Module):
    """A model of the swimmer on a task's arena, as tables."""

    predictor: InertialTable | OverdampedTable
    control_map: ControlMap
    time_cost: TimeCost

    @property
    def table(self) -> tables.FieldTable:
        """The table of the model."""
        return self.predictor.table


def tabulate_model(
    task: Task,
    model: SteeredSwimmer,
    *,
    samples: Sequence[SteeredSwimmer] = (),
    margin: float | None = None,
    points: int | None = None,
    times: int = 41,
) -> TabulatedModel:
    r"""Tables of a model on a task's arena.

    Args:
        task: the arena, the walls, the limits; its truth is not used.
        samples: of the posterior of the model, none or at least two: their spread makes
            uncertain regions cost more.
        margin: from walls, over which time costs more [L]; half the tolerance or what
            the noise asks for unless given.
        points: of the tables, along the longer side; 81 in the plane and 41 in space
            unless given.
        times: of the tables of a model that changes in time.

    Raises:
        InputError: the model is not finite on the arena; fewer than two samples.
    """
    usual = 81 if task.dim == 2 else 41
    grid = tables.Grid.over(task.arena, usual if points is None else points, margin=2)
    table = tables.tabulate_over_time(model, grid, task.time_limit, times)
    inertial = isinstance(model.dynamics, Swimmer)
    predictor = (InertialTable if inertial else OverdampedTable)(table, model.actuator)
    drive = ControlMap.of(model.actuator, task.limits, task.dim)
    at_times = tables.sample_times(
        tables.at_rest((*samples, model)[0]), grid, task.time_limit, times
    )
    if samples:
        spread = tables.force_spread(
            [tables.tabulate(one, grid, at_times) for one in samples]
        )
        thrust = greatest_rate(table, drive, inertial=inertial)
        spread = eqx.tree_at(lambda s: s.values, spread, spread.values / thrust)
    else:
        # Zeros instead of none, at as many times as samples would have: one compiled
        # program serves all models.
        nothing = jnp.zeros_like(table.values[: len(at_times), ..., :1])
        spread = dataclasses.replace(table, values=nothing, lasting=None)
    time_cost = TimeCost(
        task.keep_out,
        task.arena,
        noise_margin(task) if margin is None else margin,
        STEEPNESS,
        spread,
        RISK_AVERSION,
    )
    return TabulatedModel(predictor, drive, time_cost)


def noise_margin(task: Task) -> float:
    """Distance from walls that the noise of a task asks for [L].

    Three standard deviations of where it takes a swimmer during one time unit or, where
    the position itself is noisy, five control steps; of the sensor; and a little more,
    by the size of the arena.
    """
    reaction = 5 * task.step + task.delay
    noise = math.sqrt(reaction**3 / 3 if task.inertial else reaction)
    return 3 * math.hypot(task.noise * noise, task.sensor_noise) + task.extent / 140


def greatest_rate(
    table: tables.FieldTable, drive: ControlMap, *, inertial: bool
) -> Float[Array, ""]:
    """Greatest acceleration, or velocity, that thrust gives."""
    thrusts = drive.thrusts(HEADINGS)
    if not inertial:
        _, mobility = split_rates(table.first)
        thrusts = jnp.einsum("...ab,hb->...ha", mobility, thrusts)
    return jnp.max(jnp.linalg.norm(thrusts, axis=-1))
