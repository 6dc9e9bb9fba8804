"""The path of a swimmer from a start: a solve with an outcome."""

import enum

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int

from pinav.dynamics.solvers import AbstractSolver, Adaptive
from pinav.dynamics.swimmers import AbstractDynamics
from pinav.errors import InputError


class Outcome(enum.IntEnum):
    """How a rollout ended."""

    SUCCESS = 0
    DIVERGED = 1
    OUT_OF_STEPS = 2


class Rollout(eqx.Module):
    """A solved trajectory.

    Attributes:
        ts: times [T].
        ys: states at those times.
        outcome: an `Outcome`: diverged when a state is not finite, out of steps
            when the solver gave up before the last time.
    """

    ts: Float[Array, " time"]
    ys: Float[Array, "time state"]
    outcome: Int[Array, ""]


def rollout(
    dynamics: AbstractDynamics,
    y0: ArrayLike,
    ts: ArrayLike,
    *,
    solver: AbstractSolver | None = None,
    throw: bool = True,
) -> Rollout:
    """Solve y' = dynamics(t, y) from `y0` at `ts[0]` and save the state at each time.

    Args:
        y0: initial state, a vector.
        ts: times [T], a vector: not decreasing, at least two.
        solver: how to integrate; `Adaptive()` (Dopri8 at 1e-11) unless given.
        throw: raise when the rollout does not end in `Outcome.SUCCESS`.

    Raises:
        InputError: `y0` is not a vector or `ts` has fewer than two times.
        RuntimeError: the rollout failed and `throw` is true.
    """
    y0, ts = jnp.asarray(y0), jnp.asarray(ts)
    if y0.ndim != 1:
        raise InputError(f"rollout y0: expected one state vector, got shape {y0.shape}")
    if ts.ndim != 1 or ts.shape[0] < 2:
        raise InputError(
            f"rollout ts: expected two or more times, got shape {ts.shape}"
        )
    solver = Adaptive() if solver is None else solver
    ys, reached = solver.solve(dynamics, y0, ts.astype(y0.dtype))
    finite = jnp.all(jnp.isfinite(ys)) | ~reached
    outcome = jnp.where(
        reached & finite,
        Outcome.SUCCESS,
        jnp.where(finite, Outcome.OUT_OF_STEPS, Outcome.DIVERGED),
    )
    if throw:
        ys = eqx.error_if(
            ys,
            outcome != Outcome.SUCCESS,
            "rollout failed: the state is not finite or the solver ran out of steps; "
            "pass throw=False to get what was computed",
        )
    return Rollout(ts, ys, outcome)
