"""Steps chosen by diffrax at a tolerance."""

from typing import Any, cast

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from pinav.arguments import State, check_positive
from pinav.dynamics.solvers import AbstractSolver, Path, Times, VectorField
from pinav.forces import ScheduledThrust


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
        solution = diffrax.diffeqsolve(
            TERM,
            self.method,
            ts[0],
            ts[-1],
            None,
            y0,
            args=vector_field,
            saveat=diffrax.SaveAt(ts=ts),
            stepsize_controller=step_size_controller(self, vector_field),
            adjoint=self.adjoint,
            max_steps=self.max_steps,
            throw=False,
        )
        success = solution.result == diffrax.RESULTS.successful
        return cast(Array, solution.ys), success


TERM = diffrax.ODETerm(lambda t, y, field: field(t, y))  # pyright: ignore
"""A vector field that is given as the argument."""


def step_size_controller(
    solver: Adaptive, vector_field: VectorField
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
