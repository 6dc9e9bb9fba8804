r"""The global plan: how long it takes to the goal from anywhere, and the way there.

A controller that learns plans again and again, on one lattice and from old values.
"""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from pinav.arguments import Scalar, State, Vector
from pinav.errors import InputError
from pinav.navigation.planning.lattice import (
    lattice_values,
    phase_step,
    position_step,
    settled_values,
    top_speed,
)
from pinav.navigation.planning.value_iteration import ArrivalTest
from pinav.navigation.predictors import (
    AbstractPredictor,
    InertialTable,
    TabulatedModel,
    entry_fraction,
    tabulate_model,
)
from pinav.navigation.tables import Grid, place_words
from pinav.navigation.task.steering import Command, SteeredSwimmer
from pinav.navigation.task.task import ReachGoal, Rectangle, Task

HEADINGS = {2: 24, 3: 96}
"""Directions of the thrust that are tried at each position, and by the policy, in the
plane and in space."""

PHASE_HEADINGS = 16
"""The same where there is inertia, and four dimensions."""


class Route(eqx.Module):
    """The way along which the time-to-go falls fastest.

    Attributes:
        ys: states; the last one repeats once the goal is reached.
        arrival_time: when the goal is reached [T]; infinite if it is not.
    """

    ts: Float[Array, " time"]
    ys: Float[Array, "time state"]
    arrival_time: Float[Array, ""]


class TimeToGo(eqx.Module):
    r"""Time-to-go $T(t, y)$ on a lattice of states, of a model and a task.

    The lattice is over positions, or velocities and positions where there is inertia.
    Kept is $U = e^{-T/\tau}$, interpolated linearly; beyond the lattice it
    is that of its edge.

    Attributes:
        values: U; one time where the model does not change.
        scale: $\tau$ [T].
        step: of the plan [T]: between its times; the policy looks as far ahead.
        horizon: what takes longer counts as out of reach [T].
        tolerance: its radius [L].
    """

    values: Float[Array, "moment ..."]
    lower: State
    spacing: State
    scale: Float[Array, ""]
    step: Float[Array, ""]
    horizon: float = eqx.field(static=True)
    tables: TabulatedModel
    goal: Vector
    tolerance: Float[Array, ""]

    def at(self, y: State, t: Scalar = 0.0) -> Float[Array, ""]:
        """Cost-to-go [T] from the state `y` at time `t` [T]: great out of reach.

        It is the time-to-go where walls are far and the model is certain. A state may
        have more components than the lattice has axes.
        """
        axes, dim = self.lower.shape[0], self.goal.shape[0]
        state = jnp.roll(y[:axes], axes - dim)  # velocities first
        place = (state - self.lower.astype(y.dtype)) / self.spacing.astype(y.dtype)
        if self.values.shape[0] > 1:
            moment = jnp.asarray(t, y.dtype) / self.step.astype(y.dtype)
            place = jnp.concatenate([moment[None], place])
        values = self.values if self.values.shape[0] > 1 else self.values[0]
        value = _interpolate(values, place).astype(y.dtype)
        return -self.scale.astype(y.dtype) * jnp.log(jnp.maximum(value, FLOOR))

    def time_from(self, y: State) -> float:
        """Cost-to-go [T] from a state at first, by a compiled program."""
        return float(_cost_from(self, y))

    @property
    def map(self) -> Float[np.ndarray, "*lattice"]:
        """Cost-to-go at the points of the plan's grid, from rest, at first [T]."""
        values = np.asarray(self.values[0])
        while values.ndim > self.goal.shape[0]:
            values = values[values.shape[0] // 2]
        return -float(self.scale) * np.log(np.maximum(values, FLOOR))

    @property
    def unreachable(self) -> Bool[np.ndarray, "*lattice"]:
        """Places from which the goal cannot be reached from rest in time."""
        return self.map > self.horizon

    def control(
        self, t: Scalar, y: State, previous: Command, predictor: AbstractPredictor
    ) -> Vector:
        """Direction of the greatest thrust after which the goal is nearest in time."""
        controls = self.tables.control_map.controls(HEADINGS[self.goal.shape[0]])
        step = self.step.astype(y.dtype)

        def after(control: Vector) -> Float[Array, ""]:
            command = self.tables.control_map.command(control, previous, step)
            ahead = predictor.step(t, y, command, step)
            return self.at(ahead, jnp.asarray(t, y.dtype) + step)

        return controls[jnp.argmin(jax.vmap(after)(controls))]

    def route(self, start: State, step: float = 0.1) -> Route:
        """The way from a state on the model, without noise and delay."""
        return _route(self, jnp.asarray(start), step, math.ceil(self.horizon / step))


@eqx.filter_jit
def _cost_from(plan: TimeToGo, y: State) -> Float[Array, ""]:
    return plan.at(y)


FLOOR = 1e-30
"""Least value: about seventy scales of time."""


def _interpolate(
    values: Float[Array, "*lattice"], place: Float[Array, " axis"]
) -> Float[Array, ""]:
    """Linear in every coordinate, counted in cells; constant beyond the lattice."""
    most = jnp.asarray(values.shape, place.dtype)
    place = jnp.clip(place, 0.0, most - 1)
    cell = jnp.minimum(jnp.floor(place), most - 2)
    block = jax.lax.dynamic_slice(values, tuple(cell.astype(int)), (2,) * values.ndim)
    for weight in (place - cell).astype(values.dtype):
        block = block[0] + weight * (block[1] - block[0])
    return block


@eqx.filter_jit
def _route(plan: TimeToGo, start: State, step: float, count: int) -> Route:
    tables = plan.tables

    def move(
        state: tuple[State, Command, Float[Array, ""]], t: Float[Array, ""]
    ) -> tuple[tuple[State, Command, Float[Array, ""]], State]:
        y, previous, arrived = state
        control = plan.control(t, y, previous, tables.predictor)
        command = tables.control_map.command(control, previous, step)
        ahead = tables.predictor.step(t, y, command, step)
        x = y[: plan.goal.shape[0]]
        way = ahead[: plan.goal.shape[0]] - x
        when = t + step * entry_fraction(x, way, plan.goal, plan.tolerance)
        y = jnp.where(jnp.isfinite(arrived), y, ahead)
        return (y, command, jnp.minimum(arrived, when)), y

    ts = step * jnp.arange(count + 1, dtype=start.dtype)
    begin = (start, jnp.zeros_like(plan.goal), jnp.asarray(jnp.inf))
    (_, _, arrived), ys = jax.lax.scan(move, begin, ts[:-1])
    return Route(ts, jnp.concatenate([start[None], ys]), arrived)


class Planner(eqx.Module):
    """A lattice that stays while tables and values change: compiled once.

    It refuses no goal that seems out of reach: what is believed of the moment may close
    every way, and the next frame may open one.

    Attributes:
        task: what is to be done; its truth is not used.
        region: of the plan, such as the arena.
        velocities: along either axis, where there is inertia [L T⁻¹]; else None.
    """

    task: Task
    objective: ReachGoal
    region: Rectangle
    grid: Grid
    velocities: Float[Array, " velocity"] | None = None

    @classmethod
    def of(
        cls,
        task: Task,
        objective: ReachGoal,
        tables: TabulatedModel,
        *,
        points: int,
        speeds: int,
        region: Rectangle | None = None,
        headroom: float = 1.0,
    ) -> "Planner":
        """The lattice of a task.

        Args:
            tables: of a model, by which the velocities are chosen.
            points: along the longer side of the region.
            speeds: points along either axis of the velocity.
            headroom: greatest speed over that of the thrust against the drag.
        """
        region = task.arena if region is None else region
        planner = cls(task, objective, region, Grid.over(region, points))
        if not isinstance(tables.predictor, InertialTable):
            return planner
        thrusts = tables.control_map.thrusts(PHASE_HEADINGS)
        top = headroom * top_speed(task, tables, thrusts)
        velocities = jnp.linspace(-top, top, speeds)
        return dataclasses.replace(planner, velocities=velocities)

    @property
    def cell(self) -> float:
        """Longer side of a cell [L]."""
        return float(jnp.max(self.grid.spacing))

    def plan(
        self,
        tables: TabulatedModel,
        begin: Float[Array, "moment ..."] | None = None,
        *,
        sweeps: int | None = None,
    ) -> TimeToGo:
        """The plan after some sweeps.

        Args:
            tables: of the model, or of what is believed.
            begin: values of the last plan; zeros unless given.
            sweeps: at most; until the values have settled unless given.
        """
        task, grid, velocities = self.task, self.grid, self.velocities
        table, shape, lower, spacing = (
            tables.table,
            grid.shape,
            grid.lower,
            grid.spacing,
        )
        arrival = self._arrival(tables)
        most = None if sweeps is None else jnp.asarray(sweeps)
        if velocities is None:
            # Times would be a fourth axis in space: there the plan is that of the mean.
            table = table if task.dim == 2 else table.mean
            step = position_step(table, arrival, grid)
        else:
            step = phase_step(arrival, velocities)
            if most is None:
                most = jnp.asarray(math.ceil(task.time_limit / float(step)))
            shape = (len(velocities), len(velocities), *shape)
            width = velocities[1] - velocities[0]
            lower = jnp.concatenate([jnp.full(2, velocities[0]), lower])
            spacing = jnp.concatenate([jnp.full(2, width), spacing])
        if sweeps is not None and begin is None:
            begin = jnp.zeros((1, *shape), jnp.float32)
        steady = table.values.shape[0] == 1
        if steady and begin is None and most is None:
            values = settled_values(table, arrival, grid, self.region)
        else:
            times = None if steady else jnp.arange(0.0, task.time_limit, float(step))
            values = lattice_values(
                table,
                arrival,
                grid,
                velocities,
                step,
                times=times,
                begin=begin,
                most=most,
            )
        return TimeToGo(
            values,
            lower,
            spacing,
            scale=arrival.scale,
            step=step,
            horizon=float(task.time_limit),
            tables=tables,
            goal=arrival.goal,
            tolerance=arrival.tolerance,
        )

    def _arrival(self, tables: TabulatedModel) -> ArrivalTest:
        """The purpose of a plan; its goal is not smaller than the grid can show."""
        headings = HEADINGS[self.task.dim]
        if self.velocities is not None:
            headings = PHASE_HEADINGS
        tolerance = max(float(self.objective.tolerance), self.cell / 4)
        return ArrivalTest(
            self.objective.goal,
            jnp.asarray(tolerance),
            tables.time_cost,
            tables.control_map.thrusts(headings),
            jnp.asarray(self.task.time_limit / 2),
        )


def time_to_go(
    task: Task,
    model: SteeredSwimmer,
    *,
    tables: TabulatedModel | None = None,
    points: int | None = None,
    speeds: int = 21,
) -> TimeToGo:
    """Plan a task with a model.

    Args:
        task: whose objective is to reach a place; its truth is not used.
        tables: tables of the model; `tabulate_model(task, model)` unless given.
        points: of the plan, along the longer side of the arena; 101 for positions in
            the plane, 41 for positions in space and for positions and velocities in
            the plane unless given.
        speeds: points of the plan along either axis of the velocity.

    Raises:
        InputError: the task is to follow a path; start or goal are in a wall or outside
            the arena; the model is not finite; the goal cannot be reached; the swimmer
            has inertia in space.
    """
    if not isinstance(task.objective, ReachGoal):
        raise InputError(
            f"task {task.name!r}: expected a place to reach, got "
            f"{type(task.objective).__name__}; a path needs no plan"
        )
    tables = tabulate_model(task, model) if tables is None else tables
    check_places(task)
    inertial = isinstance(tables.predictor, InertialTable)
    if inertial and task.dim > 2:
        raise InputError(
            f"task {task.name!r}: expected a swimmer without inertia in {task.dim} "
            "dimensions, where a plan over positions and velocities has no bounds that "
            "memory keeps; give a system of order 1"
        )
    if points is None:
        points = 101 if task.dim == 2 and not inertial else 41
    plan = Planner.of(task, task.objective, tables, points=points, speeds=speeds).plan(
        tables
    )
    check_reachable(task, plan)
    return plan


def check_places(task: Task) -> None:
    """Refuse a start or goal that is in a wall or outside the arena.

    Raises:
        InputError: it is.
    """
    places = {"start": task.start[: task.dim]}
    if isinstance(task.objective, ReachGoal):
        places["goal"] = task.objective.goal
    for name, x in places.items():
        where = place_words(x)
        if not float(task.arena.distance(x)) <= 0:
            raise InputError(f"{name}: expected a place in the arena, got {where}")
        if any(float(zone.distance(x)) < 0 for zone in task.keep_out):
            raise InputError(f"{name}: expected a free place, got {where} in a wall")


def check_reachable(task: Task, plan: TimeToGo) -> None:
    """Refuse a goal that cannot be reached from the start.

    Raises:
        InputError: it cannot.
    """
    if plan.time_from(task.start) > plan.horizon:
        start = task.start[: task.dim]
        raise InputError(
            f"goal: expected a place that can be reached within {plan.horizon:g}, got "
            f"{place_words(plan.goal)} from {place_words(start)}; walls or drift are "
            "stronger than this thrust"
        )
