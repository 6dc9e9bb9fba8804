"""Temperatures that a posterior predicts of the target over the whole protocol."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.fitting.engine.posterior import Posterior
from pinav.thermal.heated_run import FOLLOWED, Watched
from pinav.thermal.protocols import plan_steps
from pinav.thermal.setup import Setup
from pinav.thermal.solve import run


class Forecast(eqx.Module):
    """Predicted temperatures of the target, over the whole protocol.

    Attributes:
        values: temperatures by `FOLLOWED`, at each time [°C].
        true: the same temperatures of the truth, where it is known [°C].
        residual: root mean square residual of the later readings, as that of the fit;
            none where there are none.
    """

    DERIVED = ("largest_sd", "error", "covered")

    times: Float[np.ndarray, " time"]
    values: Float[np.ndarray, "time quantity"]
    sd: Float[np.ndarray, "time quantity"]
    fitted_until: float
    true: Float[np.ndarray, "time quantity"] | None = None
    residual: float | None = None

    @property
    def largest_sd(self) -> float:
        """Largest standard deviation after the readings that were fitted [K]."""
        return float(self.sd[self._later].max())

    @property
    def error(self) -> float | None:
        """Largest error after these readings, where the truth is known [K]."""
        return None if self.true is None else float(self._errors.max())

    @property
    def covered(self) -> float | None:
        """Fraction of later temperatures with the truth in the band of 95 %."""
        if self.true is None:
            return None
        return float((self._errors <= 1.96 * self.sd[self._later]).mean())

    @property
    def _later(self) -> np.ndarray:
        return self.times > self.fitted_until

    @property
    def _errors(self) -> np.ndarray:
        return np.abs(self.values - self.true)[self._later]


MOMENTS = 30
"""Number of times of a forecast."""


def forecast_times(setup: Setup) -> Float[np.ndarray, " time"]:
    """Times of a forecast over the whole protocol [s]."""
    return np.linspace(0.0, setup.protocol.duration, MOMENTS + 1)[1:]


def forecast(
    setup: Setup, posterior: Posterior, times: Float[np.ndarray, " time"]
) -> tuple[Float[np.ndarray, "time quantity"], Float[np.ndarray, "time quantity"]]:
    """Temperatures by `FOLLOWED` [°C] and their standard deviations [K].

    By the delta method, in forward mode: there are fewer parameters than temperatures.
    """
    follow = follow_target(setup, times)

    @eqx.filter_jit
    def curves_and_slopes(free: Any, theta: Array) -> tuple[Array, Array]:
        value, push = jax.linearize(lambda at: follow(free(at)), theta)
        return value, jnp.moveaxis(jax.lax.map(push, jnp.eye(len(theta))), 0, -1)

    with jax.enable_x64(new_val=True):
        theta = jnp.asarray(posterior.mean)
        values, slopes = map(np.asarray, curves_and_slopes(posterior.free, theta))
    variance = np.einsum("tqp,pr,tqr->tq", slopes, posterior.covariance, slopes)
    return values, np.sqrt(np.maximum(variance, 0.0))


def follow_target(
    setup: Setup, times: Float[np.ndarray, " time"]
) -> Callable[[Any], Array]:
    """Temperatures of the target at times, as a function of the model."""
    watched = Watched.of(setup, None)
    longest = setup.stepper.longest_step(setup.model)
    schedule = plan_steps(setup.protocol, longest, save_at=times)

    def follow(model: Any) -> Array:
        solution = run(
            model,
            setup.protocol,
            schedule,
            stepper=setup.stepper,
            observe=watched.temperatures,
            start=setup.start,
        )
        return jnp.stack([solution.observed[name] for name in FOLLOWED], axis=-1)

    return follow
