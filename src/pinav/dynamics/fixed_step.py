"""Explicit Runge-Kutta methods with fixed steps, and their exact gradient."""

import functools
import operator
from collections.abc import Callable

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from pinav.arguments import Scalar, State
from pinav.dynamics.solvers import AbstractSolver, Path, Times, VectorField
from pinav.errors import InputError


class Tableau(eqx.Module):
    """Butcher tableau of an explicit Runge-Kutta method.

    Attributes:
        nodes: c, one number per stage.
        stages: rows of a below the diagonal, from the second stage on.
        weights: b, one number per stage.
    """

    nodes: tuple[float, ...] = eqx.field(static=True)
    stages: tuple[tuple[float, ...], ...] = eqx.field(static=True)
    weights: tuple[float, ...] = eqx.field(static=True)


def _tsit5() -> Tableau:
    """Tsit5 without its seventh stage, which serves the error estimate alone."""
    source = diffrax.Tsit5.tableau
    return Tableau(
        nodes=(0.0, *map(float, source.c[:-1])),
        stages=tuple(tuple(map(float, row)) for row in source.a_lower[:-1]),
        weights=tuple(map(float, source.b_sol[:-1])),
    )


TSIT5 = _tsit5()
"""Tsitouras' 5th-order method (Comput. Math. Appl. 62, 2011), the paper's solver."""


RK4 = Tableau(
    nodes=(0.0, 0.5, 0.5, 1.0),
    stages=((0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    weights=(1 / 6, 1 / 3, 1 / 3, 1 / 6),
)
"""The classical 4th-order Runge-Kutta method."""


class FixedStep(AbstractSolver):
    r"""Explicit Runge-Kutta, `substeps` equal steps from each sample to the next.

    The reverse-mode gradient is the exact one of the discrete solution
    (discretise, then optimise), arranged for speed: the states are computed once in
    sequence; the Jacobians $A_k = \partial F/\partial u_k$ of all steps F at once;
    what is left in sequence is the short linear recursion
    $\delta_{k+1} = A_k \delta_k + \delta F_k$. First derivatives are exact in either
    mode; second derivatives through a rollout are not and must not be taken.

    Attributes:
        substeps: steps between two samples, positive.

    Raises:
        InputError: `substeps` is not positive.
    """

    tableau: Tableau = TSIT5
    substeps: int = eqx.field(static=True, default=1)

    def __check_init__(self) -> None:
        if self.substeps < 1:
            raise InputError(f"FixedStep.substeps: expected >= 1, got {self.substeps}")

    def step(
        self, vector_field: VectorField, y: State, t0: Scalar, t1: Scalar
    ) -> State:
        """State at `t1` from the state `y` at `t0` [T]; quick to run."""
        return _substeps(_runge_kutta_step, self, vector_field, y, t0, t1)

    def looped_step(
        self, vector_field: VectorField, y: State, t0: Scalar, t1: Scalar
    ) -> State:
        """The same up to rounding; quick to compile."""
        return _substeps(_looped_runge_kutta_step, self, vector_field, y, t0, t1)

    def solve(self, vector_field: VectorField, y0: State, ts: Times) -> Path:
        states = _fixed_step_solve(vector_field, y0, ts, self)
        return states, jnp.ones((), bool)


@eqx.filter_custom_jvp
def _fixed_step_solve(
    vector_field: VectorField, y0: State, ts: Times, solver: FixedStep
) -> Float[Array, "time state"]:
    def record(y: State, interval: Float[Array, "2"]) -> tuple[State, State]:
        y_next = solver.step(vector_field, y, interval[0], interval[1])
        return y_next, y_next

    _, later = jax.lax.scan(record, y0, jnp.stack([ts[:-1], ts[1:]], axis=1))
    return jnp.concatenate([y0[None], later])


@_fixed_step_solve.def_jvp
def _fixed_step_jvp(
    primals: tuple[VectorField, State, Times, FixedStep],
    tangents: tuple[PyTree, State | None, Times | None, PyTree],
) -> tuple[Float[Array, "time state"], Float[Array, "time state"]]:
    """All steps are linearised at once; a short recursion joins them."""
    vector_field, y0, ts, solver = primals
    field_tangent, y0_tangent, ts_tangent, _ = tangents
    states = _fixed_step_solve(vector_field, y0, ts, solver)
    starts = states[:-1]

    def jacobian(y: State, t0: Scalar, t1: Scalar) -> Float[Array, "state state"]:
        return jax.jacfwd(lambda y: solver.step(vector_field, y, t0, t1))(y)

    def one_step(field: VectorField, ts: Times) -> Float[Array, "step state"]:
        return jax.vmap(solver.step, (None, 0, 0, 0))(field, starts, ts[:-1], ts[1:])

    jacobians = jax.vmap(jacobian)(starts, ts[:-1], ts[1:])
    _, sources = eqx.filter_jvp(
        one_step, (vector_field, ts), (field_tangent, ts_tangent)
    )
    if y0_tangent is None:
        y0_tangent = jnp.zeros_like(y0)
    return states, linear_recursion(y0_tangent, jacobians, sources)


def linear_recursion(
    start: State,
    matrices: Float[Array, "step state state"],
    sources: Float[Array, "step state"],
) -> Float[Array, "step+1 state"]:
    """Solution of d[k+1] = A[k] d[k] + s[k] from d[0] = `start`.

    The product is a sum of scaled columns: inside a scan that is several times
    faster on a CPU than a small matrix product.
    """

    def advance(
        delta: State, inputs: tuple[Float[Array, "state state"], State]
    ) -> tuple[State, State]:
        matrix, source = inputs
        columns = (matrix[:, i] * delta[i] for i in range(delta.shape[0]))
        delta = sum(columns, source)
        return delta, delta

    _, deltas = jax.lax.scan(advance, start, (matrices, sources), unroll=4)
    return jnp.concatenate([start[None], deltas])


def _substeps(
    step: Callable[[Tableau, VectorField, State, Scalar, Scalar], State],
    solver: FixedStep,
    vector_field: VectorField,
    y: State,
    t0: Scalar,
    t1: Scalar,
) -> State:
    """State at t1, by `solver.substeps` equal steps from the state y at t0."""
    h = (t1 - t0) / solver.substeps
    if solver.substeps == 1:
        return step(solver.tableau, vector_field, y, t0, h)

    def substep(y: State, index: Int[Array, ""]) -> tuple[State, None]:
        # A loop compiles faster than the steps in a row.
        t = t0 + index.astype(y.dtype) * h
        return step(solver.tableau, vector_field, y, t, h), None

    return jax.lax.scan(substep, y, jnp.arange(solver.substeps))[0]


def _runge_kutta_step(
    tableau: Tableau, vector_field: VectorField, y: State, t: Scalar, h: Scalar
) -> State:
    """The stages in a row: the quickest to run."""
    times = _stage_times(t, h, jnp.asarray(tableau.nodes, y.dtype))
    slopes = [vector_field(times[0], y)]
    for time, row in zip(times[1:], tableau.stages, strict=True):
        y_stage = y + h * _combine(row, slopes)
        slopes.append(vector_field(time, y_stage))
    return y + h * _combine(tableau.weights, slopes)


def _looped_runge_kutta_step(
    tableau: Tableau, vector_field: VectorField, y: State, t: Scalar, h: Scalar
) -> State:
    """The stages as a loop: the quickest to compile, a sixth of the code."""
    count = len(tableau.nodes)
    rows = np.zeros((count, count))
    for index, row in enumerate(tableau.stages, start=1):
        rows[index, :index] = row
    nodes, rows, weights = (
        jnp.asarray(numbers, y.dtype)
        for numbers in (tableau.nodes, rows, tableau.weights)
    )

    def stage(
        slopes: Float[Array, "stage state"],
        inputs: tuple[Int[Array, ""], Scalar, Float[Array, " stage"]],
    ) -> tuple[Float[Array, "stage state"], None]:
        index, time, row = inputs
        slope = vector_field(time, y + h * (row @ slopes))
        return slopes.at[index].set(slope), None

    empty = jnp.zeros((count, y.shape[0]), y.dtype)
    times = _stage_times(t, h, nodes)
    slopes, _ = jax.lax.scan(stage, empty, (jnp.arange(count), times, rows))
    return y + h * (weights @ slopes)


def _stage_times(
    t: Scalar, h: Scalar, nodes: Float[Array, " stage"]
) -> Float[Array, " stage"]:
    """Times of the stages, those at the ends moved inside the step.

    A thrust often jumps at a sample. Its value there belongs to the next step, and the
    rounding of either time must not decide between the two.
    """
    largest = jnp.maximum(jnp.abs(t), jnp.abs(t + h))
    inset = ROUNDING * jnp.finfo(nodes.dtype).eps * jnp.sign(h) * largest
    return t + nodes * h + (1 - 2 * nodes) * inset


ROUNDING = 8.0
"""Units in the last place by which a time may be off."""


def _combine(weights: tuple[float, ...], slopes: list[State]) -> State:
    terms = zip(weights, slopes, strict=True)
    products = (weight * slope for weight, slope in terms if weight != 0.0)
    return functools.reduce(operator.add, products)
