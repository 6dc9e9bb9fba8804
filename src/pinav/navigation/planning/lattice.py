r"""Lattices of states: what is swept over them, how far a step goes, and values."""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from pinav.arguments import Planar, Scalar
from pinav.navigation.model.tables import FieldTable, Grid
from pinav.navigation.model.tabulated import TabulatedModel
from pinav.navigation.planning.value_iteration import (
    ArrivalTest,
    Sweep,
    iterate_sweeps,
    phase_sweep,
    position_sweep,
    sweep_back,
)
from pinav.navigation.task.objectives import ReachGoal
from pinav.navigation.task.task import Task

CELLS = 1.5
"""How many cells a step of the plan crosses, at most."""

Start = Float[Array, "moment ..."] | None
"""Values of a plan before, from which a steady model is swept on; zeros for None."""


def arrival_test(
    objective: ReachGoal,
    time_limit: float,
    tables: TabulatedModel,
    grid: Grid,
    headings: int,
) -> ArrivalTest:
    """What a plan is about; its goal is not smaller than the grid can show.

    Args:
        objective: the place to reach.
        time_limit: horizon of the plan [T].
        tables: of the model.
        grid: of positions.
        headings: directions of the thrust that are tried.
    """
    tolerance = max(float(objective.tolerance), float(jnp.max(grid.spacing)) / 4)
    return ArrivalTest(
        objective.goal,
        jnp.asarray(tolerance),
        tables.time_cost,
        tables.control_map.thrusts(headings),
        jnp.asarray(time_limit / 2),
    )


def position_steps(
    table: FieldTable, arrival: ArrivalTest, grid: Grid
) -> Float[Array, "x y heading"]:
    """How long a step from each point in each direction is, to cross `CELLS` [T]."""
    speeds = _speeds(table, arrival.thrusts, grid)
    speeds = jnp.maximum(speeds, SLOWEST * jnp.max(speeds))
    return CELLS * jnp.min(grid.spacing) / speeds


@eqx.filter_jit
def position_values(
    table: FieldTable,
    arrival: ArrivalTest,
    grid: Grid,
    steps: Float[Array, "x y heading"],
    times: Float[Array, " moment"] | None,
    begin: Start = None,
    most: int | Int[Array, ""] | None = None,
) -> Float[Array, "moment x y"]:
    """Values over positions, for a swimmer without inertia.

    Args:
        table: of the model.
        arrival: what the plan is about.
        grid: the positions.
        steps: how long the step from each point in each direction is [T].
        times: of a model that changes [T]; None for a steady one.
        begin: values from which a steady model is swept.
        most: sweeps; as many as there may be cells on the way unless given.
    """

    def sweep_at(t: Scalar) -> Sweep:
        return position_sweep(table, arrival, grid, t, steps)

    most = 20 * max(grid.shape) if most is None else most
    return _settle(sweep_at, grid.shape, most, times, begin)


def sweep_times(
    task: Task, tables: TabulatedModel, step: float
) -> Float[Array, " moment"] | None:
    """When a plan is swept, as far apart as its steps; None for a steady model."""
    steady = tables.table.values.shape[0] == 1
    return None if steady else jnp.arange(0.0, task.time_limit, step)


def _settle(
    sweep_at: Callable[[Scalar], Sweep],
    shape: tuple[int, ...],
    most: int | Int[Array, ""],
    times: Float[Array, " moment"] | None,
    begin: Start,
) -> Float[Array, "moment ..."]:
    """Values at each time; at one time, after `most` sweeps, for a steady model."""
    if times is None:
        first = jnp.zeros(shape, jnp.float32) if begin is None else begin[0]
        return iterate_sweeps(sweep_at(0.0), first, most, SETTLED)[None]
    return sweep_back(sweep_at, times, shape)


SETTLED = 1e-5
"""Change of U by a sweep, below which the values of a plan have settled."""


SLOWEST = 0.2
"""Least speed for which a step of the plan is made longer, of the greatest one."""


@eqx.filter_jit
def _speeds(
    table: FieldTable, thrusts: Float[Array, "heading 2"], grid: Grid
) -> Float[Array, "x y heading"]:
    """Speed at each point of a grid in each direction of the thrust [L T⁻¹]."""

    def speeds(x: Planar) -> Float[Array, " heading"]:
        rates = table(0.0, x)
        velocities = rates[None, :2] + thrusts @ rates[2:].reshape(2, 2).T
        return jnp.linalg.norm(velocities, axis=1)

    return jax.vmap(jax.vmap(speeds))(grid.points)


def phase_step(
    arrival: ArrivalTest, velocities: Float[Array, " velocity"]
) -> Float[Array, ""]:
    """How long a step is, for the thrust to cross less than a cell [T]."""
    width = velocities[1] - velocities[0]
    return 0.7 * width / jnp.max(jnp.linalg.norm(arrival.thrusts, axis=1))


@eqx.filter_jit
def phase_values(
    table: FieldTable,
    arrival: ArrivalTest,
    grid: Grid,
    velocities: Float[Array, " velocity"],
    steps: tuple[Float[Array, ""], Int[Array, ""]],
    times: Float[Array, " moment"] | None,
    begin: Start = None,
) -> Float[Array, "moment velocity velocity x y"]:
    """Values over velocities and positions, for a swimmer with inertia.

    Args:
        table: of the model.
        arrival: what the plan is about.
        grid: the positions.
        velocities: the lattice along either axis [L T⁻¹].
        steps: how long a step is [T], and how many sweeps there may be.
        times: of a model that changes [T]; None for a steady one.
        begin: values from which a steady model is swept.
    """
    step, most = steps
    shape = (velocities.shape[0], velocities.shape[0], *grid.shape)

    def sweep_at(t: Scalar) -> Sweep:
        return phase_sweep(table, arrival, grid, t, velocities, step)

    return _settle(sweep_at, shape, most, times, begin)


def top_speed(task: Task, tables: TabulatedModel, arrival: ArrivalTest) -> float:
    """Speed that the plan has to know: where thrust and mean force meet the drag."""
    values = tables.table.values
    thrust = float(jnp.max(jnp.linalg.norm(arrival.thrusts, axis=1)))
    force = float(jnp.mean(jnp.linalg.norm(values[..., :2], axis=-1)))
    drag = float(jnp.mean(values[..., 2] + values[..., 5])) / 2
    extent = float(jnp.linalg.norm(task.arena.upper - task.arena.lower))
    longest = math.sqrt(2 * (thrust + force) * extent)
    terminal = (thrust + force) / drag if drag > 0 else longest
    return max(min(terminal, longest), float(jnp.linalg.norm(task.start[2:4])))
