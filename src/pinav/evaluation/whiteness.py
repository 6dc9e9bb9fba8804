r"""Tests that the residuals of a fit are white, as the noise of a camera would be.

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
from jaxtyping import Array, Bool, Float

from pinav.dynamics import AbstractDynamics, with_dtype
from pinav.trajectories import Trajectories

LAGS = 10
"""Largest lag."""


class Whiteness(eqx.Module):
    """Autocorrelation of residuals, and the test that they have none.

    Attributes:
        channels: names of the channels.
        autocorrelation: at lags 1, 2, ...; NaN where there is no pair.
        statistic: Ljung and Box's Q of each channel; NaN where nothing was observed.
        p_value: chance of a larger one if the residuals were white.
        counts: residuals of each channel.
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
        residuals: observed less fitted, in any unit.
        observed: where there was an observation; what is not finite does not count.
        channels: names of the channels.
        lags: largest lag.
    """
    rows = [
        _channel(residuals[..., i], observed[..., i], lags)
        for i in range(len(channels))
    ]
    correlations, statistics, p_values, counts = zip(*rows, strict=True)
    return Whiteness(
        channels,
        np.stack(correlations),
        np.array(statistics),
        np.array(p_values),
        tuple(counts),
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
        model: the fitted dynamics of the positions, without noise.
        trajectories: what it was fitted to.
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


def _channel(
    z: Float[np.ndarray, "trajectory time"],
    observed: Bool[np.ndarray, "trajectory time"],
    lags: int,
) -> tuple[Float[np.ndarray, " lag"], float, float, int]:
    from scipy.special import chdtrc

    is_observed = observed & np.isfinite(z)
    z = np.where(is_observed, z, 0.0)
    count, power = int(is_observed.sum()), float((z**2).sum())
    if power == 0.0:
        return np.full(lags, np.nan), np.nan, np.nan, count
    products = np.full(lags, np.nan)
    pairs = np.zeros(lags)
    for lag in range(1, min(lags, z.shape[1] - 1) + 1):
        pairs[lag - 1] = (is_observed[:, lag:] & is_observed[:, :-lag]).sum()
        products[lag - 1] = (z[:, lag:] * z[:, :-lag]).sum()
    used = pairs > 0
    correlation = np.where(used, products / power, np.nan)
    terms = correlation[used] ** 2 / pairs[used]
    statistic = float(count * (count + 2) * terms.sum())
    freedom = int(used.sum())
    p_value = float(chdtrc(freedom, statistic)) if freedom else np.nan
    return correlation, statistic if freedom else np.nan, p_value, count
