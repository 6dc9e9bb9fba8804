r"""The implicit method for grids with one axis, its derivative, and laws that jump.

The stages of all steps are the root of one system of equations, which is what is
differentiated: a tangent solves the linear system forward in time, a cotangent its
transpose backward, with the stored stages and two tridiagonal solves a step. All else,
derivatives by properties and sources among it, is computed for all steps at once.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.bioheat import COLDEST, WARMEST, Bioheat, HeatBalance, Rates
from pinav.thermal.perfusion import BLEND, AbstractPerfusion
from pinav.thermal.quantities import Field, Number, Numbers
from pinav.thermal.steppers import AbstractStepper, Levels, March, Watch, check_step

LOOKED_INTO, PARTS = 8, 101
"""Intervals of temperature with the largest changes, and points within each."""

POINTS = LOOKED_INTO * PARTS
"""Temperatures at which a law is looked at, half of `BLEND` apart."""

SUDDEN = 0.05
"""Share of the change nearby that a jump has within half a millikelvin; of a law that
rises over `BLEND` it is 0.005."""

SMALLEST_JUMP = 1e-4
"""Of the largest perfusion; less changes no temperature that is measured."""


def refuse_jumps(model: Bioheat) -> None:
    """Refuse a model whose perfusion jumps at some temperature.

    Raises:
        InputError: it does.
    """
    law, shape = model.perfusion, model.grid.shape
    edges = np.linspace(COLDEST, WARMEST, POINTS)
    coarse, largest = map(np.asarray, _changes(law, shape, edges))
    steepest = np.argsort(coarse)[-LOOKED_INTO:]
    nearby = np.convolve(coarse, np.ones(3), mode="same")[steepest]
    places = np.linspace(edges[steepest], edges[steepest + 1], PARTS, axis=1)
    fine, _ = map(np.asarray, _changes(law, shape, places.reshape(-1)))
    # the last change of a row leads to another interval
    changes = np.append(fine, 0.0).reshape(LOOKED_INTO, PARTS)[:, :-1]
    sudden = changes > np.maximum(SUDDEN * nearby, SMALLEST_JUMP * largest)[:, None]
    if sudden.any():
        place = np.unravel_index(np.argmax(sudden * changes), changes.shape)
        raise InputError(
            f"perfusion: expected a law without jumps, got one that changes by "
            f"{changes[place]:.3g} kg/(m³ s) at {places[place]:.2f} °C; no derivative "
            f"sees a jump: let it rise over {BLEND:g} K"
        )


@eqx.filter_jit
def _changes(
    law: AbstractPerfusion, shape: tuple[int, ...], temperatures: Numbers
) -> tuple[Float[Array, " interval"], Float[Array, ""]]:
    """Largest change of any cell from one temperature to the next, and its largest."""

    def step(before: Array, celsius: Array) -> tuple[Array, tuple[Array, Array]]:
        after = law(jnp.full(shape, celsius))
        return after, (jnp.max(jnp.abs(after - before)), jnp.max(after))

    at = jnp.asarray(temperatures, float)
    first = law(jnp.full(shape, at[0]))
    _, (changes, values) = jax.lax.scan(step, first, at[1:])
    return changes, jnp.max(values)


GAMMA = 1 - 1 / np.sqrt(2.0)
"""For which the method is L-stable."""

Cells = Float[Array, " cell"]


class Rosenbrock(AbstractStepper):
    r"""The two-stage Rosenbrock method ROS2, linearly implicit and L-stable.

    $(1 - \gamma\Delta t J) k_1 = f(T) + \gamma\Delta t f_t$ and
    $(1 - \gamma\Delta t J) k_2 = f(T + \Delta t k_1) - 2 k_1 - \gamma\Delta t f_t$,
    $\gamma = 1 - 1/\sqrt2$, change $\Delta t (3 k_1 + k_2)/2$. Two tridiagonal solves
    and no iteration, whatever the perfusion; it does not ring after a switch, so that
    no starting steps are needed. For radial grids.

    Attributes:
        longest: time step [s].

    Raises:
        InputError: `longest` is not positive.

    References:
        Verwer, Spee, Blom and Hundsdorfer, SIAM J. Sci. Comput. 20, 1456 (1999).
    """

    longest: Number = eqx.field(static=True, default=7.5)

    def __check_init__(self) -> None:
        check_step("Rosenbrock.longest", self.longest)

    @property
    def nodes(self) -> Float[np.ndarray, " node"]:
        return np.array([0.0, 1.0])

    @property
    def kept_values(self) -> int:
        return 1_000_000  # some forty arrays as large: a third of a gigabyte

    def longest_step(self, model: Bioheat) -> float:
        axes = len(model.grid.shape)
        if axes != 1:
            raise InputError(
                f"Rosenbrock: expected a grid with one axis, got {axes}; use RKL2()"
            )
        return self.longest

    def march(
        self,
        balance: HeatBalance,
        temperature: Field,
        total: PyTree,
        steps: Float[Array, " step"],
        levels: Levels,
        watch: Watch,
    ) -> "March":
        inputs = _Inputs(balance, temperature, steps, levels)
        stages = _stages(inputs)
        before = stages.before(temperature)
        added = jax.vmap(watch.accrue)(before, stages.after, steps)
        totals = jax.tree.map(
            lambda t, a: t[None] + jnp.cumsum(a, axis=0), total, added
        )
        kept = jax.vmap(watch.keep)(stages.after, totals)
        first, second = _slopes(stages, inputs)
        flows = 0.5 * steps @ (3 * first.energy + second.energy)
        end = jax.tree.map(lambda t: t[-1], totals)
        return March(stages.after[-1], end, flows, kept)


class _Inputs(eqx.Module):
    """The equation, the temperature at the begin, and what each step is given."""

    balance: HeatBalance
    temperature: Cells
    steps: Float[Array, " step"]
    levels: Levels


class _Stages(eqx.Module):
    """Both stages of every step, and the temperature after it."""

    first: Float[Array, "... cell"]
    second: Float[Array, "... cell"]
    after: Float[Array, "... cell"]

    def before(self, temperature: Cells) -> Float[Array, "step cell"]:
        return jnp.concatenate([temperature[None], self.after[:-1]])


@eqx.filter_custom_jvp
def _stages(inputs: _Inputs) -> _Stages:
    balance, matrices = inputs.balance, _Matrices.of(inputs.balance)

    def step(begin: Cells, forced: tuple[Array, Array]) -> tuple[Cells, _Stages]:
        dt, (level, later) = forced
        taken = _sink_slope(balance, begin)
        # How the sources change over the step, without which a Rosenbrock method loses
        # its order where the rates depend on time.
        drift = _shift(balance, level, later).temperature

        def solve(right: Cells) -> Cells:
            return matrices.solve(GAMMA * dt, taken, right)

        k1 = solve(balance.rates(begin, level).temperature + drift)
        # both stages share one matrix, that at the begin: ROS2 keeps its order with it
        end = balance.rates(begin + dt * k1, later).temperature
        k2 = solve(end - 2 * k1 - drift)
        after = begin + 0.5 * dt * (3 * k1 + k2)
        return after, _Stages(k1, k2, after)

    return jax.lax.scan(step, inputs.temperature, (inputs.steps, inputs.levels))[1]


@_stages.def_jvp
def _stages_jvp(
    primals: tuple[_Inputs], tangents: tuple[Any]
) -> tuple[_Stages, _Stages]:
    stages = _stages(*primals)
    _, moved = eqx.filter_jvp(lambda i: _defects(stages, i), primals, tangents)
    # custom_linear_solve transposes the solve for reverse mode: no residuals of the
    # scan are stored, and nothing is recomputed
    linear = _Linearised.of(stages, *primals)
    change = jax.lax.custom_linear_solve(
        lambda d: jax.jvp(lambda s: _defects(s, *primals), (stages,), (d,))[1],
        jax.tree.map(_negative, stages, moved),
        solve=lambda _, right: linear.forward(right),
        transpose_solve=lambda _, right: linear.backward(right),
    )
    return stages, change


def _sink_slope(balance: HeatBalance, at: Cells) -> Cells:
    """Change of what blood takes from each cell with its temperature [s⁻¹]."""
    return balance.sink_slope(at) * balance.volumes * balance.inverse_capacity


def _negative(like: Array, tangent: Array | None) -> Array:
    """The negative of a tangent, of which nothing is zero."""
    return jnp.zeros_like(like) if tangent is None else -tangent


def _defects(stages: _Stages, inputs: _Inputs) -> _Stages:
    """What is zero of the stages of a run."""
    first, second = _slopes(stages, inputs)
    rise = 0.5 * inputs.steps[:, None] * (3 * stages.first + stages.second)
    return _Stages(
        stages.first - first.temperature,
        stages.second - second.temperature,
        stages.after - stages.before(inputs.temperature) - rise,
    )


def _slopes(stages: _Stages, inputs: _Inputs) -> tuple[Rates, Rates]:
    """Both stages of every step from the equations of which they are the solution."""
    balance = inputs.balance

    def each(
        begin: Cells, k1: Cells, k2: Cells, dt: Scalar, level: Array
    ) -> tuple[Rates, Rates]:
        def rates(at: Cells) -> Rates:
            return balance.rates(at, level[0])

        start, along1 = jax.jvp(rates, (begin,), (k1,))
        _, along2 = jax.jvp(rates, (begin,), (k2,))
        end = balance.rates(begin + dt * k1, level[1])
        shift = _shift(balance, level[0], level[1])
        first = _add(start, along1, shift, GAMMA * dt)
        second = _add(end, along2, jax.tree.map(jnp.negative, shift), GAMMA * dt)
        given = Rates(k1, first.energy)
        return first, jax.tree.map(lambda b, a: b - 2 * a, second, given)

    before = stages.before(inputs.temperature)
    forced = inputs.steps, inputs.levels
    return jax.vmap(each)(before, stages.first, stages.second, *forced)


def _add(rates: Rates, along: Rates, shift: Rates, weight: Scalar) -> Rates:
    return jax.tree.map(lambda r, a, s: r + weight * a + s, rates, along, shift)


def _shift(balance: HeatBalance, level: Array, later: Array) -> Rates:
    """What the change of the sources over a step adds to a stage."""
    heating = GAMMA * (balance.heating(later) - balance.heating(level))
    nothing = jnp.zeros(())
    flows = jnp.stack([jnp.sum(heating), nothing, nothing])
    return Rates(heating * balance.inverse_capacity, flows)


class _Matrices(eqx.Module):
    """Conduction between neighbours over the capacity of each."""

    lower: Cells
    diagonal: Cells
    upper: Cells

    @classmethod
    def of(cls, balance: HeatBalance) -> "_Matrices":
        (conductance,) = balance.conductances
        inverse, zero = balance.inverse_capacity, jnp.zeros(1)
        below = jnp.concatenate([zero, conductance[1:-1]])
        above = jnp.concatenate([conductance[1:-1], zero])
        diagonal = (conductance[1:] + conductance[:-1]) * inverse
        return cls(below * inverse, diagonal, above * inverse)

    @property
    def transposed(self) -> "_Matrices":
        zero = jnp.zeros(1)
        lower = jnp.concatenate([zero, self.upper[:-1]])
        upper = jnp.concatenate([self.lower[1:], zero])
        return _Matrices(lower, self.diagonal, upper)

    def solve(self, weight: Scalar, taken: Cells, right: Cells) -> Cells:
        """Solve 1 - weight * J, where blood takes `taken` of each degree."""
        bands = (
            -weight * self.lower,
            1 + weight * (self.diagonal + taken),
            -weight * self.upper,
        )
        return jax.lax.linalg.tridiagonal_solve(*bands, right[:, None])[:, 0]

    def times(self, taken: Cells, right: Cells) -> Cells:
        below = self.lower[1:] * right[:-1]
        above = self.upper[:-1] * right[1:]
        neighbours = jnp.pad(below, (1, 0)) + jnp.pad(above, (0, 1))
        return neighbours - (self.diagonal + taken) * right


class _Step(eqx.Module):
    """What the linearised equations of one step need, or of all.

    Attributes:
        first: slope of what blood takes at the begin, over the capacity [s⁻¹].
        second: the same at the second stage.
        bends: by how much both stages change the first equation's matrix [s⁻¹].
    """

    length: Field
    first: Float[Array, "... cell"]
    second: Float[Array, "... cell"]
    bends: tuple[Float[Array, "... cell"], Float[Array, "... cell"]]


class _Linearised(eqx.Module):
    """The equations of all steps, linearised at their solution."""

    matrices: _Matrices
    steps: _Step

    @classmethod
    def of(cls, stages: _Stages, inputs: _Inputs) -> "_Linearised":
        def slope(at: Cells) -> Cells:
            return _sink_slope(inputs.balance, at)

        def each(begin: Cells, k1: Cells, k2: Cells, dt: Array) -> _Step:
            first, bend = jax.jvp(slope, (begin,), (jnp.ones_like(begin),))
            bends = GAMMA * dt * bend * k1, GAMMA * dt * bend * k2
            return _Step(dt, first, slope(begin + dt * k1), bends)

        before = stages.before(inputs.temperature)
        every = jax.vmap(each)(before, stages.first, stages.second, inputs.steps)
        return cls(_Matrices.of(inputs.balance), every)

    def forward(self, right: _Stages) -> _Stages:
        """Solve for changes of the stages, from the first step on."""
        matrices = self.matrices

        def advance(
            change: Cells, inputs: tuple[_Step, _Stages]
        ) -> tuple[Cells, _Stages]:
            step, right = inputs
            dt = step.length
            push = matrices.times(step.first, change) - step.bends[0] * change
            k1 = matrices.solve(GAMMA * dt, step.first, right.first + push)
            push = (
                matrices.times(step.second, change + dt * k1) - step.bends[1] * change
            )
            k2 = matrices.solve(GAMMA * dt, step.first, right.second + push - 2 * k1)
            after = right.after + change + 0.5 * dt * (3 * k1 + k2)
            return after, _Stages(k1, k2, after)

        # A change of the start is part of the right-hand side.
        begin = jnp.zeros_like(right.after[0])
        return jax.lax.scan(advance, begin, (self.steps, right))[1]

    def backward(self, right: _Stages) -> _Stages:
        """Solve the transposed system, from the last step on."""
        matrices = self.matrices.transposed

        def retreat(
            pull: Cells, inputs: tuple[_Step, _Stages]
        ) -> tuple[Cells, _Stages]:
            step, right = inputs
            dt = step.length
            after = right.after + pull
            wanted = right.second + 0.5 * dt * after
            k2 = matrices.solve(GAMMA * dt, step.first, wanted)
            pulled = matrices.times(step.second, k2)
            wanted = right.first + 1.5 * dt * after + dt * pulled - 2 * k2
            k1 = matrices.solve(GAMMA * dt, step.first, wanted)
            bent = step.bends[0] * k1 + step.bends[1] * k2
            before = after + matrices.times(step.first, k1) + pulled - bent
            return before, _Stages(k1, k2, after)

        end = jnp.zeros_like(right.after[0])
        return jax.lax.scan(retreat, end, (self.steps, right), reverse=True)[1]
