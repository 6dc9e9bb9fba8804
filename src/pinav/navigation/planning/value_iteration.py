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

from pinav.arguments import Scalar, Vector
from pinav.navigation.predictors import TimeCost, entry_fraction, split_rates
from pinav.navigation.tables import FieldTable, Grid

PROBES = 5
"""Places along a step at which walls are looked for, its end included."""

Values = Float[Array, "*lattice"]
"""The unknown U at the points of a lattice."""

PhaseValues = Float[Array, "vx vy x y"]
"""The same over velocities and positions."""

Sweep = Callable[[Values], Values]
"""From values to better ones, one step earlier."""


class ArrivalTest(eqx.Module):
    """The purpose of a plan: a goal, and the steps that may lead there.

    Attributes:
        thrusts: the greatest thrust in every direction that is tried.
        scale: of the transform [T].
    """

    goal: Vector
    tolerance: Float[Array, ""]
    time_cost: TimeCost
    thrusts: Float[Array, "heading dim"]
    scale: Float[Array, ""]

    def leg(
        self, x: Vector, displacement: Vector, h: Scalar, risk: Scalar
    ) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        """Discount of a straight step, and whether it ends in the goal.

        A step into a wall has the discount zero.
        """
        fraction = entry_fraction(x, displacement, self.goal, self.tolerance)
        arrives = jnp.isfinite(fraction)
        fraction = jnp.where(arrives, fraction, 1.0)
        places = jnp.linspace(0.0, 1.0, PROBES)[:, None] * displacement[None]
        clearance = jax.vmap(self.time_cost.clearance)(x[None] + fraction * places)
        running_cost = 1 + jnp.mean(self.time_cost.nearness(clearance[1::2])) + risk
        discount = jnp.exp(-running_cost * fraction * h / self.scale)
        return jnp.where(jnp.all(clearance >= 0), discount, 0.0), arrives


class Corners(eqx.Module):
    """Places between the points of a lattice, for linear interpolation.

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


class Legs(eqx.Module):
    """Straight steps from the points of a grid, one or one for each direction.

    Attributes:
        discount: of what follows; zero through a wall.
    """

    discount: Float[Array, "*heading point"]
    arrives: Bool[Array, "*heading point"]
    corners: Corners

    def worth(self, values: Values) -> Float[Array, "*heading point"]:
        """Worth of each step if the rest is worth `values`."""
        onward = jnp.where(self.arrives, 1.0, self.corners.interpolate(values))
        return self.discount * onward.astype(jnp.float32)

    def best(self, values: Values) -> "Legs":
        """The step that is worth most, at each point."""
        choice = jnp.argmax(self.worth(values), axis=0)[None]
        return jax.tree.map(lambda a: jnp.take_along_axis(a, choice, 0)[0], self)


def position_legs(
    table: FieldTable,
    arrival: ArrivalTest,
    grid: Grid,
    t: Scalar,
    speeds: tuple[Scalar, Scalar],
) -> Legs:
    """Steps in every direction over positions, for a swimmer without inertia.

    Args:
        table: velocity without thrust and mobility.
        t: when the steps begin [T].
        speeds: a step is as long as crossing `CELLS` takes at its speed, or at the
            first of these where it is slower; not longer than at the second [L T⁻¹].
    """
    points = grid.row
    drift, mobility = split_rates(jax.vmap(lambda x: table(t, x))(points))
    risk = jax.vmap(lambda x: arrival.time_cost.risk(t, x))(points)
    lattice_risk = risk.reshape(grid.shape).astype(jnp.float32)
    reach = CELLS * jnp.min(grid.spacing)

    def along(thrust: Vector) -> Legs:
        velocities = drift + mobility @ thrust
        h = reach / jnp.clip(jnp.linalg.norm(velocities, axis=1), *speeds)
        ways = h[:, None] * velocities
        feet = jax.vmap(grid.coordinates)(points + ways)
        corners = Corners.of(tuple(feet.T), grid.shape)
        # Of both ends: to look it up on the way would take most of the time of a plan.
        ahead = corners.interpolate(lattice_risk).astype(risk.dtype)
        mean_risk = (risk + ahead) / 2
        discount, arrives = jax.vmap(arrival.leg)(points, ways, h, mean_risk)
        return Legs(discount.astype(jnp.float32), arrives, corners)

    # One direction after the other: all at once do not fit into memory in space.
    return jax.lax.map(along, arrival.thrusts)


CELLS = 1.5
"""How many cells a step of the plan crosses, at most."""


def position_sweep(legs: Legs, shape: tuple[int, ...]) -> Sweep:
    """A sweep over positions: the best of all steps at each point."""
    return lambda values: jnp.max(legs.worth(values), axis=0).reshape(shape)


def iterate_policies(
    legs: Legs, begin: Values, most: int | Int[Array, ""], tolerance: float
) -> Values:
    """Values that the best steps no longer change by more than `tolerance`.

    Between two searches for the best steps the last ones are followed many times,
    which costs little: modified policy iteration.

    References:
        Puterman and Shin, Management Science 24, 1127 (1978).
    """
    shape = begin.shape

    def search(values: Values) -> Values:
        best = legs.best(values)

        def follow(_: Int[Array, ""], values: Values) -> Values:
            return best.worth(values).reshape(shape)

        return jax.lax.fori_loop(0, FOLLOWED, follow, values)

    return iterate_sweeps(search, begin, most, tolerance)


FOLLOWED = 24
"""How often the best steps are followed before better ones are sought."""


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
    rates = jax.vmap(lambda x: table(t, x))(grid.row).reshape(*grid.shape, -1)
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
        x: Vector, vx: Scalar, vy: Scalar
    ) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        way = h * jnp.stack([vx, vy])
        places = x[None] + jnp.array([[0.25], [0.75]]) * way[None]
        risk = jax.vmap(lambda place: arrival.time_cost.risk(t, place))(places)
        return arrival.leg(x, way, h, jnp.mean(risk))

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
    """Values that a sweep no longer changes by more than `tolerance`."""

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
    """Values at each time for a model that changes; after the last there is no goal."""

    def earlier(values: Values, t: Float[Array, ""]) -> tuple[Values, Values]:
        values = sweep_at(t)(values)
        return values, values

    begin = jnp.zeros(shape, jnp.float32)
    return jax.lax.scan(earlier, begin, times, reverse=True)[1]
