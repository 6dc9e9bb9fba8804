"""Least squares with priors: linear cases in closed form, and honest failures."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.errors import FitError, InputError
from pinav.fitting import Outcome
from pinav.fitting.least_squares import fit_regression
from pinav.forces.priors import IsotropicPrior


class Line(eqx.Module):
    """Two numbers, and weights that add features of no consequence elsewhere."""

    offset: jax.Array
    slope: jax.Array
    weights: jax.Array


class LineResiduals(eqx.Module):
    """Of a line plus weighted sines, at some places."""

    x: jax.Array
    y: jax.Array

    def __call__(self, model):
        order = jnp.arange(1.0, model.weights.shape[0] + 1)
        features = jnp.sin(order[None] * self.x[:, None])
        return model.offset + model.slope * self.x + features @ model.weights - self.y


def problem(count=60, noise=0.1):
    rng = np.random.default_rng(0)
    x = np.linspace(-1.0, 2.0, count)
    y = 0.7 - 0.4 * x + noise * rng.normal(size=count)
    return LineResiduals(jnp.asarray(x), jnp.asarray(y))


def line(num_weights=0):
    return Line(jnp.asarray(0.0), jnp.asarray(0.0), jnp.zeros(num_weights))


def both(model):
    return model.offset, model.slope


def test_flat_constants_are_those_of_least_squares():
    data = problem()
    fit = fit_regression(line(), data, constants=both)
    design = np.stack([np.ones(60), np.asarray(data.x)], axis=1)
    best, squares, *_ = np.linalg.lstsq(design, np.asarray(data.y))
    variance = float(squares[0]) / (60 - 2)
    covariance = variance * np.linalg.inv(design.T @ design)
    found = [fit.constants[name] for name in ("offset", "slope")]
    assert [own.value for own in found] == pytest.approx(best, rel=1e-6)
    assert [own.sd for own in found] == pytest.approx(
        np.sqrt(np.diag(covariance)), rel=1e-6
    )
    assert fit.hyperparameters.noise == pytest.approx(np.sqrt(variance), rel=1e-6)
    assert fit.outcome is Outcome.CONVERGED


def test_weights_with_a_prior_are_those_of_ridge_regression():
    data = problem()
    fit = fit_regression(
        line(4),
        data,
        weights=lambda m: m.weights,
        prior=IsotropicPrior(4),
        constants=both,
        noise=0.1,
    )
    amplitude = fit.hyperparameters.amplitude
    x = np.asarray(data.x)
    design = np.stack([np.ones(60), x, *(np.sin(k * x) for k in range(1, 5))], axis=1)
    precision = np.diag([0, 0, 1, 1, 1, 1]) / amplitude**2
    covariance = np.linalg.inv(design.T @ design / 0.01 + precision)
    mean = covariance @ design.T @ np.asarray(data.y) / 0.01
    order = [fit.posterior.free.unravel(jnp.arange(6.0))]  # where each leaf stands
    place = [order[0].offset, order[0].slope, *order[0].weights]
    place = np.array([int(p) for p in place])
    assert fit.posterior.mean[place] == pytest.approx(mean, abs=1e-6)
    own = fit.posterior.covariance[np.ix_(place, place)]
    assert own == pytest.approx(covariance, rel=1e-5, abs=1e-12)


TIMES = jnp.linspace(0.0, 3.0, 40)


def of_decay(rate):
    """Residuals of exp(-rate t) where the rate is 1.3."""
    return jnp.exp(-rate * TIMES) - jnp.exp(-1.3 * TIMES)


AFAR = jnp.asarray(0.1)


def test_a_nonlinear_constant_is_found_from_afar():
    fit = fit_regression(AFAR, of_decay, constants=lambda rate: rate)
    (rate,) = fit.constants.values()
    assert rate.value == pytest.approx(1.3, rel=1e-6)


def test_honest_failures_and_mistakes():
    data = problem()

    def fit(x, y, constants=both):
        return fit_regression(line(), LineResiduals(x, y), constants=constants)

    with pytest.raises(InputError, match="nothing to learn"):
        fit_regression(line(), data)
    with pytest.raises(InputError, match="expected more than 2 residuals.*got 2"):
        fit(data.x[:2], data.y[:2])
    with pytest.raises(FitError, match="diverged"):
        fit(data.x, data.y.at[3].set(jnp.nan), lambda m: m.offset)
    with pytest.raises(FitError, match="do not determine the learned constants"):
        fit(jnp.zeros(9), data.y[:9])
    with pytest.raises(FitError, match="stalled after 1 steps"):
        fit_regression(AFAR, of_decay, constants=lambda rate: rate, max_iterations=1)
