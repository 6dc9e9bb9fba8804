"""Root-mean-square errors of rollouts.

Every rollout is solved anew in float64 at a tight tolerance, whatever the fit
used, so that a fit cannot profit from the errors of its own integrator.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from pinav.arguments import on_device
from pinav.dynamics import (
    AbstractDynamics,
    AbstractSolver,
    ForwardOnly,
    Outcome,
    drive_by_arrays,
    rollout,
    takes_commands,
    with_dtype,
)
from pinav.errors import InputError
from pinav.trajectories import POSITION_CHANNELS, Trajectories


class Score(eqx.Module):
    """Root-mean-square errors of rollouts against observed states.

    Attributes:
        channels: names of the components of the state.
        rmse: error of each component, over all observed samples; NaN where a
            component was never observed.
        outcomes: how the rollout of each trajectory ended.
    """

    channels: tuple[str, ...] = eqx.field(static=True)
    rmse: Float[np.ndarray, " state"]
    outcomes: tuple[Outcome, ...] = eqx.field(static=True)

    @property
    def total(self) -> float:
        """Root mean square of the errors of all observed ones (paper, Table 2)."""
        return _root_mean_square(self.rmse)

    @property
    def position(self) -> float:
        """Root mean square of the errors of the position components alone."""
        chosen = [name in POSITION_CHANNELS for name in self.channels]
        return _root_mean_square(self.rmse[chosen])

    def by_name(self) -> dict[str, float]:
        """Each error by its name, without what was never observed."""
        errors = zip(self.channels, map(float, self.rmse), strict=True)
        by_channel = {name: error for name, error in errors if not np.isnan(error)}
        return by_channel | {"total": self.total, "position": self.position}


def _root_mean_square(errors: Float[np.ndarray, " state"]) -> float:
    known_errors = errors[~np.isnan(errors)]
    return (
        float(np.sqrt(np.mean(known_errors**2))) if known_errors.size else float("nan")
    )


def predict(
    dynamics: AbstractDynamics,
    trajectories: Trajectories,
    *,
    starts: Float[np.ndarray, "trajectory state"] | None = None,
    driven_by: Trajectories | None = None,
    solver: AbstractSolver | None = None,
) -> tuple[Float[np.ndarray, "trajectory time state"], tuple[Outcome, ...]]:
    """Rollouts over the times of each trajectory, in float64.

    A propulsion that takes commands is driven by those of each trajectory.

    Args:
        dynamics: the model, in any precision; it is cast exactly.
        trajectories: when to save.
        starts: first state of each rollout; the first sample unless given. A rollout
            from one that is not finite counts as diverged.
        driven_by: whose commands drive each rollout, row by row: windows of long
            trajectories need the commands from before they begin, because of the
            delay. `trajectories` unless given.
        solver: how to integrate; `ForwardOnly()` (Dopri8 at 1e-11) unless given.

    Returns:
        The states, and how each rollout ended: a diverged one is data, not an error.

    Raises:
        InputError: a first sample is not fully observed, or x64 is switched off.
    """
    require_x64("scoring")
    starts = _first_samples(trajectories) if starts is None else starts
    known = np.asarray(np.isfinite(starts).all(axis=1))
    first = jnp.asarray(np.where(known[:, None], starts, 0.0), jnp.float64)
    times = jnp.asarray(trajectories.times, jnp.float64)
    solver = ForwardOnly() if solver is None else solver
    source = trajectories if driven_by is None else driven_by
    commands = source.commands if takes_commands(dynamics) else {}
    programme = jax.tree.map(on_device, (source.times, commands))
    model = with_dtype(dynamics, jnp.float64)
    ys, outcomes = _rollouts(model, first, times, programme, solver)
    codes = np.where(known, outcomes, Outcome.DIVERGED)
    ys = np.where(known[:, None, None], ys, np.nan)
    return ys, tuple(Outcome(int(code)) for code in codes)


def _first_samples(
    trajectories: Trajectories,
) -> Float[np.ndarray, "trajectory state"]:
    for index, first in enumerate(trajectories.observed[:, 0]):
        if not first.all():
            raise InputError(
                f"trajectory {index}: its first sample is not fully observed, so no "
                "rollout can start there; drop the samples before a complete one"
            )
    return trajectories.states[:, 0]


@eqx.filter_jit
def _rollouts(
    dynamics: AbstractDynamics,
    starts: Float[Array, "trajectory state"],
    times: Float[Array, "trajectory time"],
    programme: tuple[Array, dict[str, Array]],
    solver: AbstractSolver,
) -> tuple[Float[Array, "trajectory time state"], Int[Array, " trajectory"]]:
    def one(
        y0: Float[Array, " state"],
        ts: Float[Array, " time"],
        programme: tuple[Array, dict[str, Array]],
    ) -> tuple[Float[Array, "time state"], Int[Array, ""]]:
        model = drive_by_arrays(dynamics, *programme)
        solution = rollout(model, y0, ts, solver=solver, throw=False)
        return solution.ys, solution.outcome

    return jax.vmap(one)(starts, times, programme)


def score(
    predictions: Float[np.ndarray, "trajectory time state"],
    outcomes: tuple[Outcome, ...],
    trajectories: Trajectories,
) -> Score:
    """Errors of `predictions` over every observed entry of `trajectories`.

    A diverged rollout scores infinity.
    """
    observed = trajectories.observed
    squares = np.where(observed, (predictions - trajectories.states) ** 2, 0.0)
    squares = np.where(np.isfinite(squares), squares, np.inf)
    count = observed.sum(axis=(0, 1))
    total = squares.sum(axis=(0, 1))
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return Score(trajectories.channels, np.sqrt(mean), outcomes)


def require_x64(purpose: str) -> None:
    """Raise `InputError` where JAX would silently compute in float32."""
    if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        raise InputError(
            f"{purpose} needs float64: call "
            'jax.config.update("jax_enable_x64", True) before anything else'
        )
