"""Weights over all shapes of their prior: against quadrature, also at an edge."""

import equinox as eqx
import numpy as np
import pytest

from pinav.fitting.evidence.evidence import (
    LinearisedObservations,
    at_shape,
    best_hyperparameters,
    weight_posterior,
)
from pinav.fitting.evidence.hyperparameter_uncertainty import mix_shapes
from pinav.forces.priors import AbstractPrior


class Tilt(AbstractPrior):
    """Two weights, of which the second has the variance $e^{2s}$ of the first."""

    low: float = -4.0

    @property
    def start(self):
        return np.zeros(1)

    @property
    def bounds(self):
        return np.array([(self.low, 4.0)])

    def covariance(self, shape):
        return np.diag([1.0, np.exp(2 * shape[0])])

    def pullback(self, shape, pull):
        return np.array([2 * np.exp(2 * shape[0]) * pull[1, 1]])


def data(second: float) -> LinearisedObservations:
    """Two measured weights, known to 0.2 each."""
    return LinearisedObservations(
        rows=np.eye(2),
        targets=np.array([1.0, second]),
        squares=0.0,
        num_free=2,
        log_determinant=0.0,
    )


def by_quadrature(observed, prior, noise):
    """Mean and covariance of the mixture on a fine grid of shapes."""
    grid = np.linspace(*prior.bounds[0], 201)
    fits = [at_shape(observed, prior.covariance, np.array([s]), noise) for s in grid]
    logs = np.array([fit.log_evidence for fit in fits])
    shares = np.exp(logs - logs.max())
    shares /= shares.sum()
    parts = [
        weight_posterior(observed, prior.covariance(fit.shape), fit) for fit in fits
    ]
    means = np.array([mean for mean, _ in parts])
    mean = shares @ means
    within = np.tensordot(shares, np.array([c for _, c in parts]), axes=1)
    return mean, within + (means - mean).T * shares @ (means - mean)


@pytest.mark.slow
@pytest.mark.parametrize("second", [0.05, 0.5, 3.0])
@pytest.mark.parametrize("low", [-4.0, -1.0])
def test_it_is_the_integral_over_shapes(second, low):
    """Also where the best shape lies at the edge of what is possible."""
    observed, prior = data(second), Tilt(low)
    chosen = best_hyperparameters(observed, prior, prior.start, 0.2)
    mixed = mix_shapes(observed, prior, chosen, 0.2)
    mean, covariance = by_quadrature(observed, prior, 0.2)
    sd = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(mixed.mean, mean, atol=0.2 * sd.max())
    np.testing.assert_allclose(np.sqrt(np.diag(mixed.covariance)), sd, rtol=0.1)
    assert mixed.num_effective > 40


def test_without_a_shape_it_is_the_posterior():
    class Fixed(AbstractPrior):
        start = np.zeros(0)
        bounds = np.zeros((0, 2))

        def covariance(self, shape):
            return np.eye(2)

        def pullback(self, shape, pull):
            return np.zeros(0)

    observed = data(0.5)
    chosen = at_shape(observed, Fixed().covariance, np.zeros(0), 0.2)
    mixed = mix_shapes(observed, Fixed(), chosen, 0.2)
    mean, covariance = weight_posterior(observed, np.eye(2), chosen)
    np.testing.assert_allclose(mixed.mean, mean)
    np.testing.assert_allclose(mixed.covariance, covariance)
    assert mixed.num_effective == 1


def test_the_same_numbers_each_time():
    observed, prior = data(0.5), Tilt()
    chosen = at_shape(observed, prior.covariance, prior.start, 0.2)
    one, two = (mix_shapes(observed, prior, chosen, 0.2) for _ in range(2))
    assert eqx.tree_equal(one, two)
