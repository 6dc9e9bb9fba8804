r"""Lattices of states: how far a step goes, and the values over them."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from pinav.arguments import Scalar, Vector
from pinav.navigation.planning.value_iteration import (
    CELLS,
    ArrivalTest,
    Corners,
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
from pinav.navigation.task.task import Rectangle, Task


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


def phase_step(
    arrival: ArrivalTest, velocities: Float[Array, " velocity"]
) -> Float[Array, ""]:
    """Time of a step in which the thrust crosses less than a cell [T]."""
    width = velocities[1] - velocities[0]
    return 0.7 * width / jnp.max(jnp.linalg.norm(arrival.thrusts, axis=1))


@eqx.filter_jit
def lattice_values(
    table: FieldTable,
    arrival: ArrivalTest,
    grid: Grid,
    velocities: Float[Array, " velocity"] | None,
    step: Float[Array, ""],
    *,
    times: Float[Array, " moment"] | None = None,
    begin: Float[Array, "moment ..."] | None = None,
    most: Int[Array, ""] | None = None,
) -> Float[Array, "moment ..."]:
    """Values over positions or, with inertia, over velocities and positions.

    Args:
        velocities: the lattice along either axis [L T⁻¹]; None without inertia.
        step: length of a step [T]; without inertia, slower steps of a steady model are
            longer.
        times: of a model that changes [T]; None for a steady one.
        begin: values from which a steady model is swept; zeros for None.
        most: sweeps of a steady model, at most; None, which needs a swimmer without
            inertia, until its values have settled.
    """
    shape = grid.shape
    if velocities is not None:
        shape = (velocities.shape[0], velocities.shape[0], *shape)
    first = jnp.zeros(shape, jnp.float32) if begin is None else begin[0]
    fastest = CELLS * jnp.min(grid.spacing) / step
    speeds = (fastest if times is not None else SLOWEST * fastest, fastest)
    if velocities is None and times is None and most is None:
        legs = position_legs(table, arrival, grid, 0.0, speeds)
        return iterate_policies(legs, first, 20 * max(shape), SETTLED)[None]

    def sweep_at(t: Scalar) -> Sweep:
        if velocities is None:
            legs = position_legs(table, arrival, grid, t, speeds)
            return position_sweep(legs, shape)
        return phase_sweep(table, arrival, grid, t, velocities, step)

    if times is not None:
        return sweep_back(sweep_at, times, shape)
    assert most is not None
    return iterate_sweeps(sweep_at(0.0), first, most, SETTLED)[None]


SETTLED = 1e-5
"""Change of U by a sweep, below which the values of a plan have settled."""

SLOWEST = 0.2
"""Least speed for which a step of the plan is made longer, of the greatest one."""


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
    return lattice_values(table, arrival, grid, None, step, begin=begin)


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


def top_speed(
    task: Task, tables: TabulatedModel, thrusts: Float[Array, "heading dim"]
) -> float:
    """Speed that the plan has to know: where thrust and mean force meet the drag."""
    forces, drags = split_rates(tables.table.values)
    thrust = float(jnp.max(jnp.linalg.norm(thrusts, axis=1)))
    force = float(jnp.mean(jnp.linalg.norm(forces, axis=-1)))
    drag = float(jnp.mean(jnp.trace(drags, axis1=-2, axis2=-1))) / task.dim
    extent = float(jnp.linalg.norm(task.arena.upper - task.arena.lower))
    longest = math.sqrt(2 * (thrust + force) * extent)
    terminal = (thrust + force) / drag if drag > 0 else longest
    return max(min(terminal, longest), float(jnp.linalg.norm(task.start[task.dim :])))
