r"""Tables of what a model does to a swimmer, for plans and controllers.

A plan asks for the force at millions of points and a controller at thousands of them
in every step; a table answers at the same price whatever the model is.
"""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from pinav.arguments import Planar, Scalar
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.forces import cubic_weights
from pinav.navigation.task.steering import HeldThrust, SteeredSwimmer
from pinav.navigation.task.zones import Rectangle


class Grid(eqx.Module):
    """Equally spaced points of a rectangle in the plane.

    Attributes:
        lower: the first point [L].
        spacing: between neighbours along x and y [L].
        shape: how many points along x and y.
    """

    lower: Planar
    spacing: Planar
    shape: tuple[int, int] = eqx.field(static=True)

    @classmethod
    def over(cls, region: Rectangle, count: int, margin: int = 0) -> "Grid":
        """The grid that spans a rectangle, from edge to edge and `margin` cells more.

        Args:
            region: what is spanned.
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
        return cls(region.lower - margin * spacing, spacing, (shape[0], shape[1]))

    @property
    def points(self) -> Float[Array, "x y 2"]:
        """All points [L]."""
        along = [jnp.arange(n, dtype=self.spacing.dtype) for n in self.shape]
        steps = jnp.stack(jnp.meshgrid(*along, indexing="ij"), axis=-1)
        return self.lower[None, None] + steps * self.spacing[None, None]

    def coordinates(self, x: Planar) -> Planar:
        """Where a position [L] is, counted in cells from the first point."""
        return (x - self.lower) / self.spacing.astype(x.dtype)


class FieldTable(eqx.Module):
    r"""Values on a grid, interpolated by cubic convolution; linearly in time.

    Between the points the table and its gradient are continuous. It is exact where the
    values are a polynomial of degree two along each axis; else its error falls as the
    third power of the spacing, that of the gradient as the second. Beyond the last cell
    but one it continues as a constant, and so before its first and after its last time.

    Attributes:
        grid: where the values stand in space.
        values: at the points.
        start: first time [T].
        interval: between times [T], positive.

    References:
        Keys, IEEE Trans. Acoust. Speech Signal Process. 29, 1153 (1981), with a = -1/2.
    """

    grid: Grid
    values: Float[Array, "time x y channel"]
    start: Scalar = 0.0
    interval: Scalar = 1.0

    def __call__(self, t: Scalar, x: Planar) -> Float[Array, " channel"]:
        """Values at time `t` [T] and position `x` [L]."""
        most = jnp.asarray(self.grid.shape, x.dtype)
        place = jnp.clip(self.grid.coordinates(x), 1.0, most - 2.0)
        cell = jnp.minimum(jnp.floor(place), most - 3.0)
        across, along = cubic_weights(place - cell)
        corner = cell.astype(int) - 1
        weights = across[:, None] * along[None, :]
        return jnp.tensordot(weights, self._block(t, corner), 2)

    def _block(self, t: Scalar, corner: Int[Array, "2"]) -> Float[Array, "4 4 channel"]:
        """The four by four values around a place, at one time."""
        count, channels = self.values.shape[0], self.values.shape[-1]
        shape = (min(count, 2), 4, 4, channels)
        if count == 1:
            return jax.lax.dynamic_slice(self.values, (0, *corner, 0), shape)[0]
        moment = jnp.clip((jnp.asarray(t) - self.start) / self.interval, 0, count - 1)
        first = jnp.minimum(jnp.floor(moment), count - 2)
        begin = (first.astype(int), *corner, 0)
        block = jax.lax.dynamic_slice(self.values, begin, shape)
        weight = (moment - first).astype(block.dtype)
        return block[0] + weight * (block[1] - block[0])


def tabulate(
    model: SteeredSwimmer, grid: Grid, times: Float[np.ndarray, " time"]
) -> FieldTable:
    r"""Table of a model's rate of change, linear in velocity or thrust.

    Six channels: the rate without thrust and velocity, and row by row the matrix D of
    the drag, $\dot v = a - D v + u$, for a swimmer with inertia, or M of the mobility,
    $\dot x = a + M u$, for one without.

    Args:
        model: whose propulsion commands replace.
        grid: where.
        times: when [T], equally spaced; one time where nothing changes.

    Raises:
        InputError: a value is not finite.
    """
    values = np.stack(
        [np.asarray(_map(model.dynamics, t, grid.points)) for t in jnp.asarray(times)]
    )
    _check_finite(values, grid)
    interval = float(times[1] - times[0]) if len(times) > 1 else 1.0
    return FieldTable(grid, jnp.asarray(values), float(times[0]), interval)


@eqx.filter_jit
def _map(
    dynamics: Swimmer | OverdampedSwimmer, t: Scalar, points: Float[Array, "x y 2"]
) -> Float[Array, "x y channel"]:
    """Channels at many points; compiled once for all models of one form."""
    at = _rates if isinstance(dynamics, Swimmer) else _velocities
    return jax.vmap(jax.vmap(at, (None, None, 0)), (None, None, 0))(dynamics, t, points)


def _rates(
    dynamics: Swimmer | OverdampedSwimmer, t: Scalar, x: Planar
) -> Float[Array, " channel"]:
    """Acceleration at rest, and minus its change by a unit of velocity."""
    swimmer = _with_thrust(dynamics, jnp.zeros_like(x))

    def acceleration(v: Planar) -> Planar:
        return swimmer(t, jnp.concatenate([x, v]))[2:]

    return _linear(acceleration, -jnp.ones((), x.dtype), x)


def _velocities(
    dynamics: Swimmer | OverdampedSwimmer, t: Scalar, x: Planar
) -> Float[Array, " channel"]:
    """Velocity without thrust, and its change by a unit of thrust."""

    def velocity(thrust: Planar) -> Planar:
        return _with_thrust(dynamics, thrust)(t, x)

    return _linear(velocity, jnp.ones((), x.dtype), x)


def _linear(
    function: Callable[[Planar], Planar], sign: Scalar, x: Planar
) -> Float[Array, " channel"]:
    """Value at zero and signed matrix of a function that is linear.

    By two evaluations, not by a derivative: XLA 0.10 compiles the derivative of many
    kernels by what they do not depend on to values that were never written.
    """
    zero = function(jnp.zeros_like(x))
    columns = [function(unit) - zero for unit in jnp.eye(2, dtype=x.dtype)]
    return jnp.concatenate([zero, (sign * jnp.stack(columns, axis=1)).ravel()])


def _with_thrust(
    dynamics: Swimmer | OverdampedSwimmer, thrust: Planar
) -> Swimmer | OverdampedSwimmer:
    return eqx.tree_at(lambda swimmer: swimmer.propulsion, dynamics, HeldThrust(thrust))


def _check_finite(values: Float[np.ndarray, "time x y channel"], grid: Grid) -> None:
    bad = np.argwhere(~np.isfinite(values).all(axis=(0, 3)))
    if len(bad):
        x, y = np.asarray(grid.points[tuple(bad[0])])
        raise InputError(
            f"model: expected a finite force on the arena, got {len(bad)} of "
            f"{values[0, ..., 0].size} points without, as at ({x:.3g}, {y:.3g}); fit "
            "it again, or make the arena smaller"
        )


def sample_times(
    model: SteeredSwimmer, grid: Grid, time_limit: float, count: int
) -> Float[np.ndarray, " time"]:
    """Times for a table: `count` of them, or one if the model does not change in time.

    Args:
        model: of whom it is asked.
        grid: where it is looked at.
        time_limit: until when [T].
        count: of times for a model that changes.
    """
    probes = np.array([0.0, 0.31, 0.73]) * time_limit
    across, along = (n // 4 + 1 for n in grid.shape)
    coarse = Grid(grid.lower, grid.spacing * 4, (across, along))
    values = tabulate(model, coarse, probes).values
    changes = bool(jnp.any(jnp.ptp(values, axis=0) > 1e-9 * jnp.max(jnp.abs(values))))
    return np.linspace(0.0, time_limit, count) if changes else np.zeros(1)


def force_spread(tables: Sequence[FieldTable]) -> FieldTable:
    """Standard deviation of the rate without thrust over tables of sampled models.

    Args:
        tables: two or more, on one grid.

    Raises:
        InputError: there are fewer than two.
    """
    if len(tables) < 2:
        raise InputError(f"samples: expected 2 or more models, got {len(tables)}")
    rates = jnp.stack([table.values[..., :2] for table in tables])
    variance = jnp.sum(jnp.var(rates, axis=0, ddof=1), axis=-1, keepdims=True) / 2
    first = tables[0]
    return FieldTable(first.grid, jnp.sqrt(variance), first.start, first.interval)
