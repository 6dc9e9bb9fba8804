r"""Dependence of the end of a rollout on its start.

$\Phi(T) = \partial y(T)/\partial y(0)$ follows from the Jacobians of all steps. Its
block of positions says how far apart two swimmers end that start side by side with the
same velocity: its largest singular value $s$ is the factor by which their distance
grows, and $\lambda = \ln s / T$ the finite-time Lyapunov exponent. Ridges of a map of
$\lambda$ separate starts with different fates.

References:
    Shadden, Lekien and Marsden, Physica D 212, 271 (2005).
"""

from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from pinav.arguments import State
from pinav.dynamics import AbstractDynamics, FixedStep, with_dtype
from pinav.errors import InputError


def _start_slopes(
    dynamics: AbstractDynamics,
    starts: Float[np.ndarray, "start state"],
    ts: ArrayLike,
    directions: Float[np.ndarray, "direction state"],
    solver: FixedStep | None,
) -> tuple[
    Float[np.ndarray, "start state"], Float[np.ndarray, "start state direction"]
]:
    """Last states, and their derivatives along directions of the starts."""
    ts = np.asarray(ts, float)
    if ts.ndim != 1 or len(ts) < 2:
        raise InputError(
            f"lyapunov_map ts: expected two or more times, got shape {ts.shape}"
        )
    solver = FixedStep() if solver is None else solver
    with jax.enable_x64(new_val=True):
        exact = with_dtype(dynamics, jnp.float64)
        ends, slopes = _slopes(exact, starts, ts, directions, solver)
    return np.asarray(ends), np.asarray(slopes)


@eqx.filter_jit
def _slopes(
    dynamics: AbstractDynamics,
    starts: Float[ArrayLike, "start state"],
    ts: Float[ArrayLike, " time"],
    directions: Float[ArrayLike, "direction state"],
    solver: FixedStep,
) -> tuple[Float[Array, "start state"], Float[Array, "start state direction"]]:
    intervals = jnp.stack([jnp.asarray(ts)[:-1], jnp.asarray(ts)[1:]], axis=1)

    def advance(
        now: tuple[State, Float[Array, "direction state"]], interval: Float[Array, "2"]
    ) -> tuple[tuple[State, Float[Array, "direction state"]], None]:
        y, tangents = now

        def step(y: State) -> State:
            return solver.looped_step(dynamics, y, interval[0], interval[1])

        def push(tangent: State) -> tuple[State, State]:
            return jax.jvp(step, (y,), (tangent,))

        # The tangents go along, so that a step has one for each direction asked for.
        return jax.vmap(push, out_axes=(None, 0))(tangents), None

    def one(y0: State) -> tuple[State, Float[Array, "state direction"]]:
        start = y0, jnp.asarray(directions)
        (y, tangents), _ = jax.lax.scan(advance, start, intervals)
        return y, tangents.T

    return jax.lax.map(one, jnp.asarray(starts), batch_size=64)


class LyapunovMap(eqx.Module):
    r"""Finite-time Lyapunov exponents of positions over a grid of starts [L].

    Attributes:
        separation: $s$, largest singular value of $\partial x(T)/\partial x(0)$; NaN
            where the rollout is not finite.
        horizon: $T$ [T].
    """

    DERIVED: ClassVar = ("median", "greatest", "median_exponent")

    x: Float[np.ndarray, " columns"]
    y: Float[np.ndarray, " rows"]
    separation: Float[np.ndarray, "rows columns"]
    final: Float[np.ndarray, "rows columns 2"]
    horizon: float

    @property
    def median(self) -> float:
        """Median growth of separations; NaN where none is finite."""
        known = self.separation[np.isfinite(self.separation)]
        return float(np.median(known)) if known.size else float("nan")

    @property
    def greatest(self) -> float:
        """Greatest growth of separations; NaN where none is finite."""
        known = self.separation[np.isfinite(self.separation)]
        return float(known.max()) if known.size else float("nan")

    @property
    def median_exponent(self) -> float:
        """Median finite-time Lyapunov exponent [T⁻¹]; NaN where none is finite."""
        known = self.exponent[np.isfinite(self.separation)]
        return float(np.median(known)) if known.size else float("nan")

    @property
    def exponent(self) -> Float[np.ndarray, "rows columns"]:
        """Finite-time Lyapunov exponent [T⁻¹]."""
        with np.errstate(divide="ignore"):
            return np.log(self.separation) / self.horizon


def lyapunov_map(
    dynamics: AbstractDynamics,
    x: Float[np.ndarray, " columns"],
    y: Float[np.ndarray, " rows"],
    ts: ArrayLike,
    *,
    velocity: Callable[[Float[np.ndarray, " dim"]], ArrayLike] | None = None,
    solver: FixedStep | None = None,
) -> LyapunovMap:
    """Finite-time Lyapunov exponents of a planar system for starts on a grid.

    Args:
        velocity: initial velocity [L T⁻¹] as a function of the starting position. None
            means that the position is the whole state.
    """
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    starts = points
    if velocity is not None:
        velocities = [np.asarray(velocity(point), float) for point in points]
        starts = np.concatenate([points, np.stack(velocities)], axis=1)
    # Starts differ in position alone: no derivative by the velocity is needed.
    positions = np.eye(starts.shape[1])[:2]
    ends, slopes = _start_slopes(dynamics, starts, ts, positions, solver)
    finite = np.asarray(
        np.isfinite(slopes).all(axis=(1, 2)) & np.isfinite(ends).all(axis=1)
    )
    block = np.where(finite[:, None, None], slopes[:, :2], 0.0)
    separation = np.linalg.svd(block, compute_uv=False)[:, 0]
    times = np.asarray(ts, float)
    return LyapunovMap(
        x=np.asarray(x),
        y=np.asarray(y),
        separation=np.where(finite, separation, np.nan).reshape(len(y), len(x)),
        final=ends[:, :2].reshape(len(y), len(x), 2),
        horizon=float(times[-1] - times[0]),
    )
