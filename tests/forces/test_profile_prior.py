"""Priors of profiles: what they know where data end, and beside what they saw."""

import numpy as np
from tests.forces.pullbacks import check_pullback

from pinav.fitting.evidence.evidence import (
    LinearisedObservations,
    best_hyperparameters,
    weight_posterior,
)
from pinav.fitting.evidence.quadratic import Quadratic
from pinav.fitting.evidence.weights import GaussianWeights
from pinav.forces.priors import IsotropicPrior, MixturePrior, WeightPrior
from pinav.forces.profile_priors import DistancePrior, ProfilePrior

PLACES = np.linspace(0.5, 20.0, 40)
FADED = np.array([1.0, 0.5, -19.0])
"""A length scale of 2.7 widths, an envelope of 1.6 at the lower end."""


def test_a_floor_holds_the_variance_where_the_envelope_ends():
    without = ProfilePrior(PLACES, 0.5, floor=0.0).covariance(FADED)
    with_floor = ProfilePrior(PLACES, 0.5, floor=0.1).covariance(FADED)
    assert without[-1, -1] < 1e-12
    np.testing.assert_allclose(with_floor[-1, -1], 0.01, rtol=1e-9)
    np.testing.assert_allclose(with_floor[0, 0], without[0, 0] + 0.01)


def test_the_prior_of_a_distance_has_the_pullback_of_its_covariance():
    prior = DistancePrior(ProfilePrior(PLACES, 0.5, floor=0.1))
    check_pullback(prior, np.array([1.2, 2.0, -3.0]))


def test_a_profile_is_matern_of_order_seven_halves():
    # The spectrum of that order is (7 / l^2 + k^2)^-4: its ratio at two frequencies.
    spacing, scale = 0.02, 1.0
    places = np.arange(-1500, 1501) * spacing
    a = np.sqrt(7.0) * np.abs(places) / scale
    prior = ProfilePrior(np.arange(3.0) * scale, 1.0, floor=0.0)
    alike = prior.covariance(np.array([0.0, 9.0, 0.0]))
    closed = (1 + a + 0.4 * a**2 + a**3 / 15) * np.exp(-a)
    at = len(places) // 2 + np.round(np.array([0, 1, 2]) * scale / spacing).astype(int)
    np.testing.assert_allclose(alike[0], closed[at], rtol=1e-6)
    spectrum = [spacing * closed @ np.cos(k * places) for k in (0.0, 5.0)]
    np.testing.assert_allclose(spectrum[1] / spectrum[0], (7 / 32) ** 4, rtol=1e-6)


def test_a_search_begins_at_the_likeliest_of_several_envelopes():
    # A hill near the origin, seen among places that reach far out of it.
    prior = MixturePrior(DistancePrior(ProfilePrior(PLACES, 0.5)), IsotropicPrior(1))
    starts = prior.starts
    assert len(starts) == 3
    np.testing.assert_array_equal(starts[0], prior.start)
    narrow = starts[2]
    rng = np.random.default_rng(0)
    root = np.linalg.cholesky(prior.covariance(narrow) + 1e-12 * np.eye(41))
    quadratic = _seen(np.eye(41), root @ rng.normal(size=41), 1e-3, rng)
    chosen = GaussianWeights(prior).first_shape(quadratic, None)
    np.testing.assert_array_equal(chosen, narrow)


def test_the_band_of_a_wall_covers_it_where_that_of_a_smooth_process_does_not():
    z, places = np.linspace(-5.0, 5.0, 120), np.arange(-6.0, 6.01, 0.4)
    truth = 1.5 / np.cosh(z / 0.6) ** 2
    rows = np.exp(-0.5 * ((z[:, None] - places) / 0.4) ** 2)
    few, endless = ProfilePrior(places, 0.4), WeightPrior(places[:, None], 0.4)
    shares = [_share(few, rows, truth, seed) for seed in range(3)]
    assert 0.88 < np.mean(shares) < 0.99
    assert max(_share(endless, rows, truth, seed) for seed in range(3)) < 0.5


def _seen(rows, values, noise, rng):
    """Values at the rows with noise, as the quadratic of a fit."""
    residuals = -(values + noise * rng.normal(size=len(rows)))
    return Quadratic(
        point=np.zeros(rows.shape[1]),
        hessian=rows.T @ rows,
        gradient=rows.T @ residuals,
        squares=float(residuals @ residuals),
        num_free=len(rows),
        log_determinant=0.0,
    )


def _share(prior, rows, truth, seed) -> float:
    """Share of a profile that the band of 95 % covers, data everywhere."""
    data = LinearisedObservations.of(
        _seen(rows, truth, 0.01, np.random.default_rng(seed))
    )
    chosen = best_hyperparameters(data, prior, prior.start)
    mean, covariance = weight_posterior(data, prior.covariance(chosen.shape), chosen)
    sd = np.sqrt(np.maximum(((rows @ covariance) * rows).sum(axis=1), 0.0))
    return float(np.mean(np.abs(rows @ mean - truth) < 1.96 * sd))
