r"""Tables of what a model does to a swimmer, for plans and controllers.

A plan asks for the force at millions of points and a controller at thousands of them
in every step; a table answers at the same price whatever the model is.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from pinav.arguments import Scalar, Vector
from pinav.dynamics import AbstractSwimmer, OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.forces import ZeroFlow, ZeroForce, cubic_weights
from pinav.navigation.task.steering import SteeredSwimmer, with_thrust
from pinav.navigation.task.task import Rectangle


def place_words(x: Vector) -> str:
    """A position in a message: its coordinates in brackets."""
    return f"({', '.join(f'{float(coordinate):.3g}' for coordinate in x)})"


class Grid(eqx.Module):
    """Equally spaced points of a rectangle, or box.

    Attributes:
        lower: the first point [L].
        spacing: between neighbours along each axis [L].
    """

    lower: Vector
    spacing: Vector
    shape: tuple[int, ...] = eqx.field(static=True)

    @classmethod
    def over(cls, region: Rectangle, count: int, margin: int = 0) -> "Grid":
        """The grid that spans a rectangle, from edge to edge and `margin` cells more.

        Args:
            count: points along its longer side, at least 4.
            margin: cells beyond each edge.

        Raises:
            InputError: `count` is below 4.
        """
        if count < 4:
            raise InputError(f"Grid.over count: expected 4 or more, got {count}")
        extent = np.asarray(region.upper) - np.asarray(region.lower)
        cells = np.maximum(np.ceil(extent * (count - 1) / extent.max() - 1e-9), 3)
        spacing = jnp.asarray(extent / cells)
        shape = tuple(int(n) + 1 + 2 * margin for n in cells)
        return cls(region.lower - margin * spacing, spacing, shape)

    @property
    def dim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    @property
    def points(self) -> Float[Array, "*lattice dim"]:
        """All points [L]."""
        along = [jnp.arange(n, dtype=self.spacing.dtype) for n in self.shape]
        steps = jnp.stack(jnp.meshgrid(*along, indexing="ij"), axis=-1)
        ahead = (None,) * self.dim
        return self.lower[ahead] + steps * self.spacing[ahead]

    @property
    def row(self) -> Float[Array, "point dim"]:
        """All points one after the other [L], those of the last axis side by side."""
        return self.points.reshape(-1, self.dim)

    def coordinates(self, x: Vector) -> Vector:
        """A position [L], counted in cells from the first point."""
        return (x - self.lower) / self.spacing.astype(x.dtype)


class FieldTable(eqx.Module):
    r"""Values on a grid, interpolated by cubic convolution; linearly in time.

    Between the points the table and its gradient are continuous. It is exact where the
    values are a polynomial of degree two along each axis; else its error falls as the
    third power of the spacing, that of the gradient as the second. Beyond the last cell
    but one it continues as a constant, and so before its first and after its last time.

    Attributes:
        interval: between times [T], positive; the first one is 0.
        lasting: further channels, which do not change in time, or None; looked up once
            where the values are looked up at two times.

    References:
        Keys, IEEE Trans. Acoust. Speech Signal Process. 29, 1153 (1981), with a = -1/2.
    """

    grid: Grid
    values: Float[Array, "time *lattice channel"]
    interval: Scalar = 1.0
    lasting: Float[Array, "*lattice more"] | None = None

    def __call__(self, t: Scalar, x: Vector) -> Float[Array, " channel"]:
        """Values at time `t` [T] and position `x` [L]."""
        cell, within = self._cell(x)
        return self._weigh(t, cell - 1, cubic_weights(within))

    def interpolate_linearly(self, t: Scalar, x: Vector) -> Float[Array, " channel"]:
        """The same, interpolated linearly: an eighth of the work in space."""
        cell, within = self._cell(x)
        return self._weigh(t, cell, jnp.stack([1 - within, within], axis=-1))

    def _cell(self, x: Vector) -> tuple[Int[Array, " dim"], Vector]:
        """The cell that a position is in, and where in it, from 0 to 1."""
        most = jnp.asarray(self.grid.shape, x.dtype)
        place = jnp.clip(self.grid.coordinates(x), 1.0, most - 2.0)
        cell = jnp.minimum(jnp.floor(place), most - 3.0)
        return cell.astype(int), place - cell

    def _weigh(
        self, t: Scalar, corner: Int[Array, " dim"], weights: Float[Array, "dim some"]
    ) -> Float[Array, " channel"]:
        """The sum of the values from a corner on, weighted along each axis."""
        shape = (weights.shape[1],) * self.grid.dim
        block = self._block(t, corner, shape)
        if self.lasting is not None:
            more = (*shape, self.lasting.shape[-1])
            lasting = jax.lax.dynamic_slice(self.lasting, (*corner, 0), more)
            block = jnp.concatenate([block, lasting], axis=-1)
        product = functools.reduce(jnp.multiply.outer, weights)
        return jnp.tensordot(product, block, self.grid.dim)

    @property
    def first(self) -> Float[Array, "*lattice channel"]:
        """All channels at the points, at the first time."""
        if self.lasting is None:
            return self.values[0]
        return jnp.concatenate([self.values[0], self.lasting], axis=-1)

    @property
    def mean(self) -> "FieldTable":
        """The mean over time: one that does not change."""
        values = jnp.mean(self.values, axis=0, keepdims=True)
        return eqx.tree_at(lambda table: table.values, self, values)

    def _block(
        self, t: Scalar, corner: Int[Array, " dim"], points: tuple[int, ...]
    ) -> Float[Array, "*some channel"]:
        """The values at some points along each axis from a corner on, at one time."""
        count, channels = self.values.shape[0], self.values.shape[-1]
        shape = (min(count, 2), *points, channels)
        if count == 1:
            return jax.lax.dynamic_slice(self.values, (0, *corner, 0), shape)[0]
        moment = jnp.clip(jnp.asarray(t) / self.interval, 0, count - 1)
        first = jnp.minimum(jnp.floor(moment), count - 2)
        begin = (first.astype(int), *corner, 0)
        block = jax.lax.dynamic_slice(self.values, begin, shape)
        weight = (moment - first).astype(block.dtype)
        return block[0] + weight * (block[1] - block[0])


def tabulate(
    model: SteeredSwimmer, grid: Grid, times: Float[np.ndarray, " time"]
) -> FieldTable:
    r"""Table of a model's rate of change, linear in velocity or thrust.

    The channels are the rate without thrust and velocity and, row by row, the matrix D
    of the drag, $\dot v = a - D v + u$, for a swimmer with inertia, or M of the
    mobility, $\dot x = a + M u$, for one without.

    Args:
        model: whose propulsion commands replace.
        times: when [T], equally spaced from 0; one time where nothing changes.

    Raises:
        InputError: a value is not finite.
    """
    values = np.stack(
        [np.asarray(_map(model.dynamics, t, grid.row)) for t in jnp.asarray(times)]
    )
    _check_finite(values, grid)
    interval = float(times[1] - times[0]) if len(times) > 1 else 1.0
    lattice = jnp.asarray(values.reshape(len(times), *grid.shape, -1))
    return FieldTable(grid, lattice, interval)


@eqx.filter_jit
def _map(
    dynamics: AbstractSwimmer, t: Scalar, points: Float[Array, "point dim"]
) -> Float[Array, "point channel"]:
    """Channels at many points; compiled once for all models of one form."""
    at = _rates if isinstance(dynamics, Swimmer) else _velocities
    # In batches: thousands of kernels at all points at once do not fit into memory.
    return jax.lax.map(lambda x: at(dynamics, t, x), points, batch_size=BATCH)


BATCH = 512
"""Points at which a model is evaluated at once."""


def _rates(dynamics: AbstractSwimmer, t: Scalar, x: Vector) -> Float[Array, " channel"]:
    """Acceleration at rest, and minus its change by a unit of velocity."""
    swimmer = with_thrust(dynamics, jnp.zeros_like(x))

    def acceleration(v: Vector) -> Vector:
        return swimmer(t, jnp.concatenate([x, v]))[x.shape[0] :]

    return _linear(acceleration, -jnp.ones((), x.dtype), x)


def _velocities(
    dynamics: AbstractSwimmer, t: Scalar, x: Vector
) -> Float[Array, " channel"]:
    """Velocity without thrust, and its change by a unit of thrust."""

    def velocity(thrust: Vector) -> Vector:
        return with_thrust(dynamics, thrust)(t, x)

    return _linear(velocity, jnp.ones((), x.dtype), x)


def _linear(
    function: Callable[[Vector], Vector], sign: Scalar, x: Vector
) -> Float[Array, " channel"]:
    """Value at zero and signed matrix of a function that is linear.

    By two evaluations, not by a derivative: XLA 0.10 compiles the derivative of many
    kernels by what they do not depend on to values that were never written.
    """
    zero = function(jnp.zeros_like(x))
    columns = [function(unit) - zero for unit in jnp.eye(x.shape[0], dtype=x.dtype)]
    return jnp.concatenate([zero, (sign * jnp.stack(columns, axis=1)).ravel()])


def _check_finite(values: Float[np.ndarray, "time point channel"], grid: Grid) -> None:
    bad = np.flatnonzero(~np.isfinite(values).all(axis=(0, 2)))
    if len(bad):
        where = place_words(grid.row[bad[0]])
        raise InputError(
            f"model: expected a finite force on the arena, got {len(bad)} of "
            f"{values.shape[1]} points without, as at {where}; fit "
            "it again, or make the arena smaller"
        )


def sample_times(
    model: SteeredSwimmer, grid: Grid, time_limit: float, count: int
) -> Float[np.ndarray, " time"]:
    """Times for a table: `count`, or one if the model does not change in time."""
    probes = np.array([0.0, 0.31, 0.73]) * time_limit
    coarse = Grid(grid.lower, grid.spacing * 4, tuple(n // 4 + 1 for n in grid.shape))
    values = tabulate(model, coarse, probes).values
    changes = bool(jnp.any(jnp.ptp(values, axis=0) > 1e-9 * jnp.max(jnp.abs(values))))
    return np.linspace(0.0, time_limit, count) if changes else np.zeros(1)


def tabulate_over_time(
    model: SteeredSwimmer, grid: Grid, until: float, count: int
) -> FieldTable:
    """Table of a model, at `count` times if it changes in time and at one if not.

    Where nothing changes but the flow that carries a swimmer, the flow is all that is
    evaluated at each time: kernels are many, and their force stays the same.
    """
    moments, still = sample_times(model, grid, until, count), at_rest(model)
    if len(moments) == 1 or len(sample_times(still, grid, until, count)) > 1:
        return tabulate(model, grid, moments)
    table, carried = (
        tabulate(still, grid, STATIC),
        tabulate(_flow(model), grid, moments),
    )
    rates = table.values[..., : grid.dim] + carried.values[..., : grid.dim]
    mobility = table.values[0, ..., grid.dim :]
    return dataclasses.replace(carried, values=rates, lasting=mobility)


STATIC = np.zeros(1)
"""The one time of a table that does not change."""


def at_rest(model: SteeredSwimmer) -> SteeredSwimmer:
    """A model in a fluid at rest, where it has no inertia; unchanged where it has."""
    if not isinstance(model.dynamics, OverdampedSwimmer):
        return model
    still = dataclasses.replace(model.dynamics, flow=ZeroFlow())
    return dataclasses.replace(model, dynamics=still)


def _flow(model: SteeredSwimmer) -> SteeredSwimmer:
    """The flow of a model alone, where nothing else acts."""
    dynamics = model.dynamics
    assert isinstance(dynamics, OverdampedSwimmer)
    carried = OverdampedSwimmer(ZeroForce(), ZeroForce(), 1.0, flow=dynamics.flow)
    return dataclasses.replace(model, dynamics=carried)


def force_spread(tables: Sequence[FieldTable]) -> FieldTable:
    """Standard deviation of the rate without thrust over tables of sampled models.

    Raises:
        InputError: there are fewer than two.
    """
    if len(tables) < 2:
        raise InputError(f"samples: expected 2 or more models, got {len(tables)}")
    first = tables[0]
    rates = jnp.stack([table.values[..., : first.grid.dim] for table in tables])
    variance = jnp.mean(jnp.var(rates, axis=0, ddof=1), axis=-1, keepdims=True)
    return FieldTable(first.grid, jnp.sqrt(variance), first.interval)
