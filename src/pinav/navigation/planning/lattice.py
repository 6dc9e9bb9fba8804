r"""Lattices of states: what is swept over them, how far a step goes, and values."""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from pinav.arguments import Scalar, Vector
from pinav.navigation.planning.value_iteration import (
    CELLS,
    ArrivalTest,
    Corners,
    Legs,
    Sweep,
    iterate_policies,
    iterate_sweeps,
    phase_sweep,
    position_legs,
    position_sweep,
    sweep_back,
)
from pinav.navigation.predictors import TabulatedModel, split_rates
from pinav.navigation.tables import FieldTable, Grid
from pinav.navigation.task.task import ReachGoal, Rectangle, Task

Start = Float[Array, "moment ..."] | None
"""Values of a plan before, from which a steady model is swept on; zeros for None."""


def arrival_test(
    objective: ReachGoal,
    time_limit: float,
    tables: TabulatedModel,
    grid: Grid,
    headings: int,
) -> ArrivalTest:
    """The purpose of a plan; its goal is not smaller than the grid can show.

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


@eqx.filter_jit
def position_step(
    table: FieldTable, arrival: ArrivalTest, grid: Grid
) -> Float[Array, ""]:
    """Time of a step that crosses `CELLS` at the greatest speed [T]."""

    def fastest(x: Vector) -> Float[Array, ""]:
        drift, mobility = split_rates(table(0.0, x))
        velocities = drift[None] + arrival.thrusts @ mobility.T
        return jnp.max(jnp.linalg.norm(velocities, axis=1))

    speed = jnp.max(jax.vmap(fastest)(grid.row))
    return CELLS * jnp.min(grid.spacing) / speed


@eqx.filter_jit
def position_values(
    table: FieldTable,
    arrival: ArrivalTest,
    grid: Grid,
    step: Float[Array, ""],
    times: Float[Array, " moment"] | None,
    begin: Start = None,
    sweeps: Int[Array, ""] | None = None,
) -> Float[Array, "moment ..."]:
    """Values over positions, for a swimmer without inertia.

    Args:
        table: of the model.
        arrival: what the plan is about.
        grid: the positions.
        step: as `position_step` says; slower steps of a steady model are longer [T].
        times: of a model that changes [T]; None for a steady one.
        begin: values from which a steady model is swept.
        sweeps: of a steady model, at most; until its values have settled unless given.
    """
    fastest = CELLS * jnp.min(grid.spacing) / step
    slowest = fastest if times is not None else SLOWEST * fastest

    def legs_at(t: Scalar) -> Legs:
        return position_legs(table, arrival, grid, t, (slowest, fastest))

    if times is not None or sweeps is not None:
        return _settle(
            lambda t: position_sweep(legs_at(t), grid.shape),
            grid.shape,
            0 if sweeps is None else sweeps,
            times,
            begin,
        )
    first = jnp.zeros(grid.shape, jnp.float32) if begin is None else begin[0]
    most = 20 * max(grid.shape)
    return iterate_policies(legs_at(0.0), first, most, SETTLED)[None]


def settled_values(
    table: FieldTable, arrival: ArrivalTest, grid: Grid, region: Rectangle
) -> Float[Array, "1 ..."]:
    """Values over positions of a steady model, on coarser grids first.

    What a search for the best steps does not know yet it learns from the next points
    only. The values of a grid with half as many points along each axis tell it at
    once, so that few searches are left.
    """
    begin = None
    if math.prod(grid.shape) > FEW:
        coarse = Grid.over(region, (max(grid.shape) + 1) // 2)
        rough = settled_values(table, arrival, coarse, region)
        begin = _refined(rough, coarse, grid)
    step = position_step(table, arrival, grid)
    return position_values(table, arrival, grid, step, None, begin)


FEW = 3000
"""Points of a grid that needs no coarser one before it."""


@eqx.filter_jit
def _refined(
    values: Float[Array, "1 ..."], coarse: Grid, grid: Grid
) -> Float[Array, "1 ..."]:
    """Values at the points of a finer grid."""
    places = jax.vmap(coarse.coordinates)(grid.row)
    corners = Corners.of(tuple(places.T), coarse.shape)
    return corners.interpolate(values[0]).reshape(1, *grid.shape)


def sweep_times(
    task: Task, table: FieldTable, step: Float[Array, ""]
) -> Float[Array, " moment"] | None:
    """Times at which a plan is swept, a step apart; None for a steady model."""
    steady = table.values.shape[0] == 1
    return None if steady else jnp.arange(0.0, task.time_limit, float(step))


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


def phase_step(
    arrival: ArrivalTest, velocities: Float[Array, " velocity"]
) -> Float[Array, ""]:
    """Time of a step in which the thrust crosses less than a cell [T]."""
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
    forces, drags = split_rates(tables.table.values)
    thrust = float(jnp.max(jnp.linalg.norm(arrival.thrusts, axis=1)))
    force = float(jnp.mean(jnp.linalg.norm(forces, axis=-1)))
    drag = float(jnp.mean(jnp.trace(drags, axis1=-2, axis2=-1))) / task.dim
    extent = float(jnp.linalg.norm(task.arena.upper - task.arena.lower))
    longest = math.sqrt(2 * (thrust + force) * extent)
    terminal = (thrust + force) / drag if drag > 0 else longest
    return max(min(terminal, longest), float(jnp.linalg.norm(task.start[task.dim :])))
