import numpy as np
import pytest
from numpy.testing import assert_allclose

from pinav.dynamics import OverdampedSwimmer
from pinav.evaluation import increment_residuals, whiteness
from pinav.forces import ZeroForce
from pinav.trajectories import Trajectories


def of_one_series(z, lags=10):
    z = np.asarray(z)
    return whiteness(z[None, :, None], np.ones((1, len(z), 1), bool), ("x",), lags)


def test_the_statistic_is_ljung_and_boxs_by_hand():
    found = of_one_series([1.0, 1.0, -1.0, -1.0, 1.0, 1.0], lags=2)
    # sum of squares 6; products at lag 1: 1-1+1-1+1; at lag 2: -1-1-1-1
    assert_allclose(found.autocorrelation, [[1 / 6, -4 / 6]])
    expected = 6 * 8 * ((1 / 6) ** 2 / 5 + (4 / 6) ** 2 / 4)
    assert found.statistic[0] == pytest.approx(expected)
    assert found.p_value[0] == pytest.approx(np.exp(-expected / 2))  # chi2, 2 freedoms


def test_white_residuals_have_uniform_p_values_and_correlated_ones_are_found():
    random = np.random.default_rng(0)
    p = [of_one_series(random.standard_normal(300)).p_value[0] for _ in range(400)]
    assert np.mean(np.array(p) < 0.05) == pytest.approx(0.05, abs=0.03)
    assert np.median(p) == pytest.approx(0.5, abs=0.08)
    z = np.zeros(5000)
    for t in range(1, 5000):
        z[t] = 0.5 * z[t - 1] + random.standard_normal()
    found = of_one_series(z)
    assert_allclose(found.autocorrelation[0, :4], [0.5, 0.25, 0.125, 0.0625], atol=0.05)
    assert found.p_value[0] < 1e-12


def test_trajectories_are_not_joined_and_gaps_make_no_pairs():
    z = np.array([[1.0, 2.0, 3.0, 0.0], [1.0, 5.0, 1.0, 1.0]])[..., None]
    observed = np.array([[1, 1, 1, 0], [1, 0, 1, 1]], bool)[..., None]
    found = whiteness(z, observed, ("x",), lags=3)
    power = 1 + 4 + 9 + 1 + 1 + 1
    assert_allclose(found.autocorrelation[0], np.array([2 + 6 + 1, 3 + 1, 1]) / power)
    assert found.counts == (6,)
    terms = (9 / power) ** 2 / 3 + (4 / power) ** 2 / 2 + (1 / power) ** 2 / 1
    assert found.statistic[0] == pytest.approx(6 * 8 * terms)


def test_a_channel_that_nobody_observed_has_no_statistic():
    z = np.ones((1, 5, 2))
    observed = np.stack([np.ones((1, 5), bool), np.zeros((1, 5), bool)], axis=-1)
    found = whiteness(z, observed, ("x", "vx"))
    assert found.counts == (5, 0)
    assert np.isnan([found.statistic[1], found.p_value[1]]).all()
    assert np.isnan(found.autocorrelation[0, 4:]).all()


def test_increments_of_a_random_walk_are_white_and_of_unit_variance():
    """Free diffusion: the residuals are the normal numbers that made the path."""
    diffusion, step = 0.3, 0.1
    normal = np.random.default_rng(0).standard_normal((2, 4000, 2))
    moves = np.sqrt(2 * diffusion * step) * normal
    states = np.concatenate([np.zeros((2, 1, 2)), np.cumsum(moves, axis=1)], axis=1)
    times = step * np.arange(states.shape[1])
    paths = Trajectories.from_arrays(times, list(states), channels=("x", "y"))
    still = OverdampedSwimmer(ZeroForce(), ZeroForce(), 1.0)
    residuals, observed = increment_residuals(still, paths, diffusion)
    assert observed.all()
    assert_allclose(residuals, normal, atol=1e-9)
    assert min(whiteness(residuals, observed, ("x", "y")).p_value) > 1e-3
