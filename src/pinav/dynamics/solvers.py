"""Solvers as values: how y' = f(t, y) is integrated and how its gradient is taken.

| solver | forward | gradient |
|---|---|---|
| `FixedStep` | one explicit Runge-Kutta step per sample | discretise, then optimise |
| `Adaptive` | diffrax at a tolerance | that of its diffrax adjoint |
| `ForwardOnly` | the steps of `Adaptive` | none in reverse |
| `InterpolatingAdjoint` | diffrax at a tolerance, dense | continuous adjoint (paper) |
"""

import abc
import functools
import operator
from collections.abc import Callable
from typing import Any, cast

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree

from pinav.arguments import Scalar, State, check_positive
from pinav.errors import InputError
from pinav.forces import ScheduledThrust

VectorField = Callable[[Scalar, State], State]
"""Right-hand side f(t, y); a pytree, so that its leaves can be differentiated."""

Times = Float[Array, " time"]
"""Times at which the state is saved [T]."""

Path = tuple[Float[Array, "time state"], Bool[Array, ""]]
"""States at the times, and whether the solver reached the last of them."""


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


class AbstractSolver(eqx.Module):
    """Integrates a vector field from `ts[0]` and saves the state at every time."""

    @abc.abstractmethod
    def solve(self, vector_field: VectorField, y0: State, ts: Times) -> Path:
        """States at `ts` [T], and whether the solver reached the last of them.

        It reached the last time also when the states on the way are not finite.
        """


class FixedStep(AbstractSolver):
    r"""Explicit Runge-Kutta, `substeps` equal steps from each sample to the next.

    The reverse-mode gradient is the exact one of the discrete solution
    (discretise, then optimise), arranged for speed: the states are computed once in
    sequence; the Jacobians $A_k = \partial F/\partial u_k$ of all steps F at once;
    what is left in sequence is the short linear recursion
    $\delta_{k+1} = A_k \delta_k + \delta F_k$. First derivatives are exact in either
    mode; second derivatives through a rollout are not and must not be taken.

    Attributes:
        tableau: the Runge-Kutta method.
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


class Adaptive(AbstractSolver):
    """diffrax at a tolerance: for truth, for scoring, and for comparison in fits.

    Attributes:
        rtol: relative tolerance.
        atol: absolute tolerance.
        method: diffrax solver.
        adjoint: diffrax adjoint, such as `diffrax.BacksolveAdjoint()`.
        max_steps: steps after which the solver gives up.

    Raises:
        InputError: a tolerance is not positive.
    """

    rtol: float = eqx.field(static=True, default=1e-11)
    atol: float = eqx.field(static=True, default=1e-11)
    method: diffrax.AbstractERK = diffrax.Dopri8()
    adjoint: diffrax.AbstractAdjoint = diffrax.RecursiveCheckpointAdjoint()
    max_steps: int = eqx.field(static=True, default=100_000)

    def __check_init__(self) -> None:
        check_positive(self, "rtol", "atol")

    def solve(self, vector_field: VectorField, y0: State, ts: Times) -> Path:
        solution = _diffeqsolve(
            self, vector_field, y0, ts, diffrax.SaveAt(ts=ts), self.adjoint
        )
        return _states_and_success(solution)


class InterpolatingAdjoint(AbstractSolver):
    r"""diffrax forward; gradient by the continuous adjoint on its interpolation.

    Backwards in time $\dot\lambda = -(\partial f/\partial y)^\top \lambda$ and
    $\dot g = -(\partial f/\partial\theta)^\top \lambda$, with a jump of $\lambda$ by
    the loss gradient at every sample; the state comes from the forward solution's
    dense output. It is the paper's sensitivity method (optimise, then discretise):
    its gradient differs from that of the computed loss by the solver's error.

    Attributes:
        rtol: relative tolerance, forward and backward.
        atol: absolute tolerance, forward and backward.
        method: diffrax solver.
        max_steps: steps after which the forward solver gives up.

    Raises:
        InputError: a tolerance is not positive.

    References:
        PI-NAV paper, Table 1; Ma et al., arXiv:1812.01892.
    """

    rtol: float = eqx.field(static=True, default=1e-6)
    atol: float = eqx.field(static=True, default=1e-6)
    method: diffrax.AbstractERK = diffrax.Tsit5()
    max_steps: int = eqx.field(static=True, default=4096)

    def __check_init__(self) -> None:
        check_positive(self, "rtol", "atol")

    def solve(self, vector_field: VectorField, y0: State, ts: Times) -> Path:
        parameters, static = eqx.partition(vector_field, eqx.is_inexact_array)
        return _interpolating_solve((parameters, y0), static, ts, self)


@eqx.filter_custom_vjp
def _interpolating_solve(
    parameters_and_y0: tuple[PyTree, State],
    static: PyTree,
    ts: Times,
    solver: InterpolatingAdjoint,
) -> Path:
    solution = _dense_solution(parameters_and_y0, static, ts, solver)
    return _states_and_success(solution)


@_interpolating_solve.def_fwd
def _interpolating_forward(
    perturbed: PyTree,
    parameters_and_y0: tuple[PyTree, State],
    static: PyTree,
    ts: Times,
    solver: InterpolatingAdjoint,
) -> tuple[Path, diffrax.DenseInterpolation | None]:
    del perturbed
    solution = _dense_solution(parameters_and_y0, static, ts, solver)
    return _states_and_success(solution), solution.interpolation


@_interpolating_solve.def_bwd
def _interpolating_backward(
    interpolation: diffrax.DenseInterpolation,
    gradients: tuple[Float[Array, "time state"] | None, PyTree],
    perturbed: PyTree,
    parameters_and_y0: tuple[PyTree, State],
    static: PyTree,
    ts: Times,
    solver: InterpolatingAdjoint,
) -> tuple[PyTree, State]:
    """Integrate the adjoint from each sample to the one before it."""
    del perturbed
    parameters, y0 = parameters_and_y0
    loss_gradients = gradients[0]
    if loss_gradients is None:
        loss_gradients = jnp.zeros((ts.shape[0], *y0.shape), y0.dtype)

    def adjoint_field(
        t: Scalar,
        adjoint: tuple[PyTree, State],
        args: tuple[PyTree, diffrax.DenseInterpolation],
    ) -> tuple[PyTree, State]:
        parameters, interpolation = args
        y = interpolation.evaluate(t)

        def field(parameters: PyTree, y: State) -> State:
            return eqx.combine(parameters, static)(t, y)

        _, pull_back = jax.vjp(field, parameters, y)
        parameter_slope, state_slope = pull_back(adjoint[1])
        return jax.tree.map(jnp.negative, (parameter_slope, state_slope))

    def one_interval(
        adjoint: tuple[PyTree, State], inputs: tuple[Scalar, Scalar, State]
    ) -> tuple[tuple[PyTree, State], None]:
        t_late, t_early, loss_gradient = inputs
        accumulated, costate = adjoint
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(adjoint_field),  # pyright: ignore
            solver.method,
            t_late,
            t_early,
            t_early - t_late,
            (accumulated, costate + loss_gradient),
            args=(parameters, interpolation),
            stepsize_controller=step_size_controller(solver),
            adjoint=diffrax.DirectAdjoint(),
            max_steps=solver.max_steps,
            throw=False,
        )
        return jax.tree.map(lambda leaf: leaf[-1], solution.ys), None

    nothing = (jax.tree.map(jnp.zeros_like, parameters), jnp.zeros_like(y0))
    backwards = (ts[1:][::-1], ts[:-1][::-1], loss_gradients[1:][::-1])
    (accumulated, costate), _ = jax.lax.scan(one_interval, nothing, backwards)
    return accumulated, costate + loss_gradients[0]


def _dense_solution(
    parameters_and_y0: tuple[PyTree, State],
    static: PyTree,
    ts: Times,
    solver: InterpolatingAdjoint,
) -> diffrax.Solution:
    parameters, y0 = parameters_and_y0
    saveat = diffrax.SaveAt(ts=ts, dense=True)
    return _diffeqsolve(
        solver, eqx.combine(parameters, static), y0, ts, saveat, diffrax.DirectAdjoint()
    )


def _states_and_success(solution: diffrax.Solution) -> Path:
    states = cast(Array, solution.ys)
    return states, solution.result == diffrax.RESULTS.successful


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
    slopes = [vector_field(t, y)]
    for node, row in zip(tableau.nodes[1:], tableau.stages, strict=True):
        y_stage = y + h * _combine(row, slopes)
        slopes.append(vector_field(t + node * h, y_stage))
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
        index, node, row = inputs
        slope = vector_field(t + node * h, y + h * (row @ slopes))
        return slopes.at[index].set(slope), None

    empty = jnp.zeros((count, y.shape[0]), y.dtype)
    slopes, _ = jax.lax.scan(stage, empty, (jnp.arange(count), nodes, rows))
    return y + h * (weights @ slopes)


def _combine(weights: tuple[float, ...], slopes: list[State]) -> State:
    terms = zip(weights, slopes, strict=True)
    products = (weight * slope for weight, slope in terms if weight != 0.0)
    return functools.reduce(operator.add, products)


TERM = diffrax.ODETerm(lambda t, y, field: field(t, y))  # pyright: ignore
"""A vector field that is given as the argument."""


def step_size_controller(
    solver: "Adaptive | InterpolatingAdjoint", vector_field: VectorField | None = None
) -> diffrax.AbstractStepSizeController:
    """Of the tolerances; steps end where the thrust of a vector field jumps."""
    controller = diffrax.PIDController(rtol=solver.rtol, atol=solver.atol)
    jumps = jump_times(vector_field)
    if jumps is None:
        return controller
    # A step across a jump is rejected some twenty times before it is short enough.
    return diffrax.ClipStepSizeController(controller, jump_ts=jumps)


def jump_times(model: PyTree) -> Float[Array, " jump"] | None:
    """Times at which the thrust of a model jumps [T]; None where it does not."""

    def is_thrust(part: Any) -> bool:
        return isinstance(part, ScheduledThrust)

    thrusts = filter(is_thrust, jax.tree.leaves(model, is_leaf=is_thrust))
    times = [jax.lax.stop_gradient(thrust.jumps) for thrust in thrusts]
    return jnp.sort(jnp.concatenate(times)) if times else None


def _diffeqsolve(
    solver: "Adaptive | InterpolatingAdjoint",
    vector_field: VectorField,
    y0: State,
    ts: Times,
    saveat: diffrax.SaveAt,
    adjoint: diffrax.AbstractAdjoint,
) -> diffrax.Solution:
    return diffrax.diffeqsolve(
        TERM,
        solver.method,
        ts[0],
        ts[-1],
        None,
        y0,
        args=vector_field,
        saveat=saveat,
        stepsize_controller=step_size_controller(solver, vector_field),
        adjoint=adjoint,
        max_steps=solver.max_steps,
        throw=False,
    )
