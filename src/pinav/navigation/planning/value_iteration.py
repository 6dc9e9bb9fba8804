r"""Semi-Lagrangian value iteration: how soon the goal can be reached from anywhere.

The unknown is Kruzkov's transform $U = e^{-T/\tau}$ of the time-to-go T: one at the
goal, zero where the goal cannot be reached. A sweep looks one step ahead in every
direction of the greatest thrust,

$$U(y) = \max_u e^{-p\,h/\tau}\, U(y + h f(y, u)),$$

with the cost p of a unit of time. It is a contraction, so that sweeps converge whatever
the drift; numbers stay between zero and one next to walls.

References:
    Falcone and Ferretti, Semi-Lagrangian Approximation Schemes (SIAM, 2013), ch. 8.
"""

import itertools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from pinav.arguments import Planar, Scalar
from pinav.navigation.model.tables import FieldTable, Grid
from pinav.navigation.model.time_cost import TimeCost, entry_fraction

PROBES = 5
"""Places along a step at which walls are looked for, its end included."""

Values = Float[Array, "*lattice"]
"""The unknown U at the points of a lattice."""

PhaseValues = Float[Array, "vx vy x y"]
"""The same over velocities and positions."""

Sweep = Callable[[Values], Values]
"""From values to better ones, one step earlier."""


class ArrivalTest(eqx.Module):
    """What a plan is about.

    Attributes:
        goal: middle of the goal [L].
        tolerance: its radius [L].
        time_cost: walls and costs.
        thrusts: the greatest thrust in every direction that is tried.
        scale: of the transform [T].
    """

    goal: Planar
    tolerance: Float[Array, ""]
    time_cost: TimeCost
    thrusts: Float[Array, "heading 2"]
    scale: Float[Array, ""]

    def leg(
        self, t: Scalar, x: Planar, displacement: Planar, h: Scalar
    ) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        """Discount of a straight step, and whether it ends in the goal.

        A step into a wall has the discount zero.

        Args:
            t: when it begins [T].
            x: where it begins [L].
            displacement: [L].
            h: how long it takes [T].
        """
        fraction = entry_fraction(x, displacement, self.goal, self.tolerance)
        arrives = jnp.isfinite(fraction)
        fraction = jnp.where(arrives, fraction, 1.0)
        places = jnp.linspace(0.0, 1.0, PROBES)[:, None] * displacement[None]
        places = x[None] + fraction * places
        free = jax.vmap(self.time_cost.clearance)(places) >= 0
        running_cost = jax.vmap(self.time_cost.running_cost, (None, 0))(t, places[1::2])
        discount = jnp.exp(-jnp.mean(running_cost) * fraction * h / self.scale)
        return jnp.where(jnp.all(free), discount, 0.0), arrives


class Corners(eqx.Module):
    """Where places lie between the points of a lattice, for linear interpolation.

    Attributes:
        cell: index of the lower corner, per axis.
        fractions: of the way to the next point, per axis.
    """

    cell: tuple[Int[Array, "*many"], ...]
    fractions: tuple[Float[Array, "*many"], ...]

    @classmethod
    def of(
        cls, places: tuple[Float[Array, "*many"], ...], shape: tuple[int, ...]
    ) -> "Corners":
        """Corners of places in cells from the first point, clipped to the lattice."""
        clipped = [jnp.clip(a, 0, n - 1) for a, n in zip(places, shape, strict=True)]
        cell = [
            jnp.minimum(jnp.floor(a), n - 2)
            for a, n in zip(clipped, shape, strict=True)
        ]
        fractions = [a - c for a, c in zip(clipped, cell, strict=True)]
        return cls(
            tuple(c.astype(jnp.int32) for c in cell),
            tuple(s.astype(jnp.float32) for s in fractions),
        )

    def interpolate(
        self, values: Values, behind: tuple[Any, ...] = ()
    ) -> Float[Array, "*many"]:
        """Values at the places; `behind` are indices of the axes behind these."""
        total = jnp.zeros((), values.dtype)
        for corner in itertools.product((0, 1), repeat=len(self.cell)):
            index = tuple(c + k for c, k in zip(self.cell, corner, strict=True))
            weight = jnp.ones((), values.dtype)
            for fraction, k in zip(self.fractions, corner, strict=True):
                weight = weight * (fraction if k else 1 - fraction)
            total = total + weight * values[(*index, *behind)]
        return total


def position_sweep(
    table: FieldTable,
    arrival: ArrivalTest,
    grid: Grid,
    t: Scalar,
    steps: Float[Array, "x y heading"],
) -> Sweep:
    """A sweep over positions, for a swimmer without inertia.

    Args:
        table: velocity without thrust and mobility.
        arrival: the goal, the walls, the thrust.
        grid: the positions.
        t: when the steps begin [T].
        steps: how long the step from each point in each direction is [T].
    """

    def look(
        x: Planar, h: Scalar, thrust: Planar
    ) -> tuple[Float[Array, ""], Bool[Array, ""], Planar]:
        rates = table(t, x)
        displacement = h * (rates[:2] + rates[2:].reshape(2, 2) @ thrust)
        discount, arrives = arrival.leg(t, x, displacement, h)
        return discount, arrives, grid.coordinates(x + displacement)

    each = jax.vmap(look, (None, 0, 0))
    each = jax.vmap(jax.vmap(each, (0, 0, None)), (0, 0, None))
    discount, arrives, feet = each(grid.points, steps, arrival.thrusts)
    discount = discount.astype(jnp.float32)
    corners = Corners.of((feet[..., 0], feet[..., 1]), grid.shape)

    def sweep(values: Values) -> Values:
        onward = jnp.where(arrives, 1.0, corners.interpolate(values))
        return jnp.max(discount * onward.astype(jnp.float32), axis=-1)

    return sweep


def phase_sweep(
    table: FieldTable,
    arrival: ArrivalTest,
    grid: Grid,
    t: Scalar,
    velocities: Float[Array, " velocity"],
    h: Scalar,
) -> Sweep:
    """A sweep over velocities and positions, in this order, for a swimmer with inertia.

    A step is split: the force changes the velocity, the velocity changes the position.
    Both shifts are the same for many points, which is what makes four dimensions quick.

    Args:
        table: acceleration at rest and drag.
        arrival: the goal, the walls, the thrust.
        grid: the positions.
        t: when the step begins [T].
        velocities: the lattice along either axis [L T⁻¹].
        h: how long the step is [T].
    """
    kick, impulse = _kicks(table, grid, t, velocities, h)
    coast = _coast(grid, arrival, t, velocities, h)
    width = velocities[1] - velocities[0]
    shifts = arrival.thrusts * impulse / width

    def sweep(values: Values) -> Values:
        return kick(_best_thrust(coast(values), shifts))

    return sweep


def _kicks(
    table: FieldTable,
    grid: Grid,
    t: Scalar,
    velocities: Float[Array, " velocity"],
    h: Scalar,
) -> tuple[Sweep, Scalar]:
    """The change of velocity by force and drag, and that by a unit of thrust."""
    count = velocities.shape[0]
    v = jnp.stack(jnp.meshgrid(velocities, velocities, indexing="ij"), axis=-1)
    rates = jax.vmap(jax.vmap(table, (None, 0)), (None, 0))(t, grid.points)
    drag = rates[..., 2:].reshape(*grid.shape, 2, 2)
    damping = jnp.mean(jnp.trace(drag, axis1=2, axis2=3)) / 2
    impulse = h * (1 - damping * h / 2)
    after = jnp.einsum("xyab,ijb->ijxya", _decay(h * drag), v)
    after = after + impulse * rates[None, None, :, :, :2]
    places = (after - velocities[0]) / (velocities[1] - velocities[0])
    corners = Corners.of((places[..., 0], places[..., 1]), (count, count))
    behind = jnp.ogrid[tuple(slice(n) for n in grid.shape)]
    behind = tuple(index[None, None] for index in behind)
    return lambda values: corners.interpolate(values, behind), impulse


def _decay(exponent: Float[Array, "x y 2 2"]) -> Float[Array, "x y 2 2"]:
    """Padé's approximation of exp(-A) for many 2 x 2 matrices."""
    identity = jnp.eye(2)[None, None]
    even = identity + exponent @ exponent / 12
    return jnp.linalg.solve(even + exponent / 2, even - exponent / 2)


def _coast(
    grid: Grid,
    arrival: ArrivalTest,
    t: Scalar,
    velocities: Float[Array, " velocity"],
    h: Scalar,
) -> Sweep:
    """The way at constant velocity, separately along x and y, and its discount."""

    def leg(
        x: Planar, vx: Scalar, vy: Scalar
    ) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        return arrival.leg(t, x, h * jnp.stack([vx, vy]), h)

    each = jax.vmap(jax.vmap(leg, (0, None, None)), (0, None, None))
    each = jax.vmap(jax.vmap(each, (None, None, 0)), (None, 0, None))
    discount, arrives = each(grid.points, velocities, velocities)
    discount = discount.astype(jnp.float32)
    along = [
        Corners.of(
            (
                jnp.arange(n, dtype=velocities.dtype)[None]
                + h * velocities[:, None] / spacing,
            ),
            (n,),
        )
        for n, spacing in zip(grid.shape, grid.spacing, strict=True)
    ]

    def coast(values: PhaseValues) -> PhaseValues:
        moved = _rows(along[0], jnp.transpose(values, (0, 2, 1, 3)))  # vx, x, vy, y
        moved = _rows(along[1], jnp.transpose(moved, (2, 3, 0, 1)))  # vy, y, vx, x
        moved = jnp.transpose(moved, (2, 0, 3, 1))
        return discount * jnp.where(arrives, jnp.float32(1.0), moved)

    return coast


def _rows(
    corners: Corners, values: Float[Array, "velocity place across along"]
) -> Float[Array, "velocity place across along"]:
    """Rows of each table at its own places between rows."""
    cell, fraction = corners.cell[0], corners.fractions[0]
    fraction = fraction[..., None, None]
    lower = jax.vmap(lambda table, index: table[index])(values, cell)
    upper = jax.vmap(lambda table, index: table[index])(values, cell + 1)
    return lower + fraction * (upper - lower)


def _best_thrust(values: PhaseValues, shifts: Float[Array, "heading 2"]) -> PhaseValues:
    """The best value that one thrust, of less than a cell, leads to.

    All directions in one loop over the nine neighbours, which a compiler can vectorise.
    """
    count = values.shape[0]
    near = jnp.pad(values, ((1, 1), (1, 1), (0, 0), (0, 0)), "edge")
    near = jax.lax.optimization_barrier(near)  # else it is computed anew in each term
    neighbours = [
        [near[i : i + count, j : j + count] for j in range(3)] for i in range(3)
    ]
    weights = jnp.maximum(
        0.0, 1 - jnp.abs(shifts[..., None] - jnp.arange(-1.0, 2.0)[None, None])
    )
    weights = weights.astype(values.dtype)
    best = jnp.zeros_like(values)
    for across, along in weights:
        terms = [
            across[i] * along[j] * neighbours[i][j] for i in range(3) for j in range(3)
        ]
        best = jnp.maximum(best, sum(terms[1:], terms[0]))
    return jax.lax.optimization_barrier(best)


def iterate_sweeps(
    sweep: Sweep,
    begin: Values,
    most: int | Int[Array, ""],
    tolerance: float,
) -> Values:
    """Values that a sweep no longer changes by more than `tolerance`.

    Args:
        sweep: of a model that does not change in time.
        begin: the first values: zeros, or those of a plan before.
        most: sweeps.
        tolerance: greatest change.
    """

    def improve(
        state: tuple[Values, Float[Array, ""], Int[Array, ""]],
    ) -> tuple[Values, Float[Array, ""], Int[Array, ""]]:
        values, _change, count = state
        new = sweep(values)
        return new, jnp.max(jnp.abs(new - values)), count + 1

    first = (begin, jnp.ones((), jnp.float32), jnp.zeros((), int))
    return jax.lax.while_loop(
        lambda state: (state[1] > tolerance) & (state[2] < most), improve, first
    )[0]


def sweep_back(
    sweep_at: Callable[[Float[Array, ""]], Sweep],
    times: Float[Array, " moment"],
    shape: tuple[int, ...],
) -> Float[Array, "moment ..."]:
    """Values at each time for a model that changes; after the last there is no goal.

    Args:
        sweep_at: the sweep whose steps begin at a time [T].
        times: as far apart as the steps are long [T].
        shape: of the lattice.
    """

    def earlier(values: Values, t: Float[Array, ""]) -> tuple[Values, Values]:
        values = sweep_at(t)(values)
        return values, values

    begin = jnp.zeros(shape, jnp.float32)
    return jax.lax.scan(earlier, begin, times, reverse=True)[1]
