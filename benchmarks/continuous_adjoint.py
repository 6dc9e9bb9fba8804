"""The paper's sensitivity method: the continuous adjoint on a dense solution."""

from typing import cast

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar, State, check_positive
from pinav.dynamics.solvers import TERM, AbstractSolver, Path, Times, VectorField


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
            stepsize_controller=_controller(solver),
            adjoint=diffrax.DirectAdjoint(),
            max_steps=solver.max_steps,
            throw=False,
        )
        return jax.tree.map(lambda leaf: leaf[-1], solution.ys), None

    nothing = (jax.tree.map(jnp.zeros_like, parameters), jnp.zeros_like(y0))
    backwards = (ts[1:][::-1], ts[:-1][::-1], loss_gradients[1:][::-1])
    (accumulated, costate), _ = jax.lax.scan(one_interval, nothing, backwards)
    return accumulated, costate + loss_gradients[0]


def _controller(solver: InterpolatingAdjoint) -> diffrax.PIDController:
    return diffrax.PIDController(rtol=solver.rtol, atol=solver.atol)


def _dense_solution(
    parameters_and_y0: tuple[PyTree, State],
    static: PyTree,
    ts: Times,
    solver: InterpolatingAdjoint,
) -> diffrax.Solution:
    parameters, y0 = parameters_and_y0
    return diffrax.diffeqsolve(
        TERM,
        solver.method,
        ts[0],
        ts[-1],
        None,
        y0,
        args=eqx.combine(parameters, static),
        saveat=diffrax.SaveAt(ts=ts, dense=True),
        stepsize_controller=_controller(solver),
        adjoint=diffrax.DirectAdjoint(),
        max_steps=solver.max_steps,
        throw=False,
    )


def _states_and_success(solution: diffrax.Solution) -> Path:
    states = cast(Array, solution.ys)
    return states, solution.result == diffrax.RESULTS.successful
