r"""Root-mean-square errors of rollouts, and tests that residuals are white.

Every rollout is solved anew in float64 at a tight tolerance, whatever the fit
used, so that a fit cannot profit from the errors of its own integrator.

The normalised residuals $z_t$ of one channel, over all trajectories and wherever both
partners of a pair were observed, have the autocorrelation

$$r_k = \sum_t z_t z_{t+k} \Big/ \sum_t z_t^2 .$$

Ljung and Box's statistic $Q = n (n+2) \sum_{k=1}^{h} r_k^2 / n_k$, with n residuals and
$n_k$ pairs of lag k ($n - k$ in a single complete series), is $\chi^2_h$ for white
noise. Its degrees of freedom are not reduced by the fitted parameters, which are few
against the residuals. The mean is not subtracted: an offset is not white either.

References:
    Ljung and Box, Biometrika 65, 297 (1978).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

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
    """Root-mean-square errors of rollouts; NaN for components that nobody observed."""

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
        starts: first state of each rollout; the first sample unless given. A rollout
            from one that is not finite counts as diverged.
        driven_by: whose commands drive each rollout, row by row: windows of long
            trajectories need the commands from before they begin, because of the
            delay. `trajectories` unless given.
        solver: how to integrate; `ForwardOnly()` (Dopri8 at 1e-11) unless given.

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
    """Errors over every observed entry; infinite where the rollout diverged."""
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


LAGS = 10
"""Largest lag."""


class Whiteness(eqx.Module):
    """Autocorrelation of residuals, and the test that they have none.

    Attributes:
        autocorrelation: at lags 1, 2, ...; NaN where there is no pair.
        statistic: Ljung and Box's Q of each channel; NaN where nothing was observed.
        p_value: chance of a larger one if the residuals were white.
    """

    channels: tuple[str, ...] = eqx.field(static=True)
    autocorrelation: Float[np.ndarray, "channel lag"]
    statistic: Float[np.ndarray, " channel"]
    p_value: Float[np.ndarray, " channel"]
    counts: tuple[int, ...] = eqx.field(static=True)


def whiteness(
    residuals: Float[np.ndarray, "trajectory time channel"],
    observed: Bool[np.ndarray, "trajectory time channel"],
    channels: tuple[str, ...],
    lags: int = LAGS,
) -> Whiteness:
    """Autocorrelation and Ljung-Box test of each channel.

    Args:
        observed: where there was an observation; what is not finite does not count.
    """
    from scipy.special import chdtrc

    seen = observed & np.isfinite(residuals)
    z = np.where(seen, residuals, 0.0)
    counts, power = seen.sum(axis=(0, 1)), (z**2).sum(axis=(0, 1))
    products, pairs = np.zeros((2, lags, len(channels)))
    for lag in range(1, min(lags, z.shape[1] - 1) + 1):
        products[lag - 1] = (z[:, lag:] * z[:, :-lag]).sum(axis=(0, 1))
        pairs[lag - 1] = (seen[:, lag:] & seen[:, :-lag]).sum(axis=(0, 1))
    used = (pairs > 0) & (power > 0)
    correlation = products / np.where(power > 0, power, 1.0)
    terms = np.where(used, correlation**2 / np.maximum(pairs, 1.0), 0.0)
    freedom = used.sum(axis=0)
    statistic = counts * (counts + 2) * terms.sum(axis=0)
    statistic = np.where(freedom > 0, statistic, np.nan)
    return Whiteness(
        channels,
        np.where(used, correlation, np.nan).T,
        statistic,
        chdtrc(freedom, statistic),
        tuple(counts.tolist()),
    )


def increment_residuals(
    model: AbstractDynamics, trajectories: Trajectories, diffusion: float
) -> tuple[
    Float[np.ndarray, "trajectory time state"],
    Bool[np.ndarray, "trajectory time state"],
]:
    r"""Normalised residuals of the increments of stochastic paths.

    $(x_{k+1} - x_k - f(x_k)\,\Delta t) / \sqrt{2 D \Delta t}$, which are independent
    and standard normal where the force $f$ and the diffusion $D$ are right.

    Args:
        diffusion: $D$ [L² T⁻¹], positive.

    Returns:
        The residuals, and where both ends of an increment were observed.
    """
    rates = _rates(
        with_dtype(model, jnp.float64),
        jnp.asarray(trajectories.times, jnp.float64),
        jnp.asarray(trajectories.states, jnp.float64),
    )
    steps = np.diff(trajectories.times, axis=1)[..., None]
    drifts = np.asarray(rates)[:, :-1] * steps
    # Padding repeats the last time: such steps are not observed, but divide by zero.
    scale = np.sqrt(2 * diffusion * np.where(steps > 0, steps, 1.0))
    observed = trajectories.observed[:, 1:] & trajectories.observed[:, :-1]
    residuals = (np.diff(trajectories.states, axis=1) - drifts) / scale
    return residuals, observed & (steps > 0)


@eqx.filter_jit
def _rates(
    model: AbstractDynamics,
    times: Float[Array, "trajectory time"],
    states: Float[Array, "trajectory time state"],
) -> Float[Array, "trajectory time state"]:
    return jax.vmap(jax.vmap(model))(times, states)
