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


@eqx.filter_jit
def _slopes(
    dynamics: AbstractDynamics,
    starts: Float[ArrayLike, "start state"],
    ts: Float[ArrayLike, " time"],
    directions: Float[ArrayLike, "direction state"],
) -> tuple[Float[Array, "start state"], Float[Array, "start state direction"]]:
    """Last states, and their derivatives along directions of the starts."""
    intervals = jnp.stack([jnp.asarray(ts)[:-1], jnp.asarray(ts)[1:]], axis=1)

    def advance(
        now: tuple[State, Float[Array, "direction state"]], interval: Float[Array, "2"]
    ) -> tuple[tuple[State, Float[Array, "direction state"]], None]:
        y, tangents = now

        def step(y: State) -> State:
            return FixedStep().looped_step(dynamics, y, interval[0], interval[1])

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
        return _of_finite(np.median, self.separation)

    @property
    def greatest(self) -> float:
        """Greatest growth of separations; NaN where none is finite."""
        return _of_finite(np.max, self.separation)

    @property
    def median_exponent(self) -> float:
        """Median finite-time Lyapunov exponent [T⁻¹]; NaN where none is finite."""
        return _of_finite(np.median, self.exponent[np.isfinite(self.separation)])

    @property
    def exponent(self) -> Float[np.ndarray, "rows columns"]:
        """Finite-time Lyapunov exponent [T⁻¹]."""
        with np.errstate(divide="ignore"):
            return np.log(self.separation) / self.horizon


def _of_finite(
    summary: Callable[[np.ndarray], np.floating], values: np.ndarray
) -> float:
    known = values[~np.isnan(values)]
    return float(summary(known)) if known.size else float("nan")


def lyapunov_map(
    dynamics: AbstractDynamics,
    x: Float[np.ndarray, " columns"],
    y: Float[np.ndarray, " rows"],
    ts: ArrayLike,
    *,
    velocity: Callable[[Float[np.ndarray, " dim"]], ArrayLike] | None = None,
) -> LyapunovMap:
    """Finite-time Lyapunov exponents of a planar system for starts on a grid.

    Args:
        velocity: initial velocity [L T⁻¹] as a function of the starting position. None
            means that the position is the whole state.

    Raises:
        InputError: there are fewer than two times.
    """
    times = np.asarray(ts, float)
    if times.ndim != 1 or len(times) < 2:
        raise InputError(
            f"lyapunov_map ts: expected two or more times, got shape {times.shape}"
        )
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    starts = points
    if velocity is not None:
        velocities = [np.asarray(velocity(point), float) for point in points]
        starts = np.concatenate([points, np.stack(velocities)], axis=1)
    # Starts differ in position alone: no derivative by the velocity is needed.
    positions = np.eye(starts.shape[1])[:2]
    with jax.enable_x64(new_val=True):
        exact = with_dtype(dynamics, jnp.float64)
        ends, slopes = map(np.asarray, _slopes(exact, starts, times, positions))
    finite = np.isfinite(np.concatenate([ends[..., None], slopes], axis=2))
    finite = np.asarray(finite.all(axis=(1, 2)))
    block = np.where(finite[:, None, None], slopes[:, :2], 0.0)
    separation = np.linalg.svd(block, compute_uv=False)[:, 0]
    return LyapunovMap(
        x=np.asarray(x),
        y=np.asarray(y),
        separation=np.where(finite, separation, np.nan).reshape(len(y), len(x)),
        final=ends[:, :2].reshape(len(y), len(x), 2),
        horizon=float(times[-1] - times[0]),
    )
