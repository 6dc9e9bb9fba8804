"""Residuals that are noise are called so, and those of a missing force are not."""

import numpy as np
import pytest

from pinav.fitting.engine.evidence_fit import GoodnessOfFit, goodness_of_fit

RNG = np.random.default_rng(0)


def judge(series, noise=1.0, *, known=False):
    count = sum(int(np.isfinite(r).sum()) for r in series)
    return goodness_of_fit(series, noise, float(count), noise_known=known)


def test_white_noise_is_adequate():
    goodness = judge([RNG.normal(size=(200, 2)) for _ in range(3)], known=True)
    assert goodness.is_adequate
    assert abs(goodness.reduced_chi2 - 1) < 0.2
    assert "consistent with independent noise" in goodness.statement


def test_a_slow_misfit_correlates_neighbours():
    times = np.linspace(0.0, 20.0, 200)[:, None]
    goodness = judge([RNG.normal(size=(200, 2)) + np.sin(times)])
    assert goodness.lag1 > 0.2
    assert not goodness.is_adequate
    assert "not to be trusted" in goodness.statement


def test_a_known_noise_that_is_too_small_is_a_misfit():
    residuals = [RNG.normal(size=(200, 2))]
    assert not judge(residuals, 0.5, known=True).is_adequate
    assert judge(residuals, 0.5).is_adequate


@pytest.mark.parametrize(("deviations", "is_adequate"), [(3.5, True), (4.5, False)])
def test_four_standard_deviations_of_either_statistic_are_the_limit(
    deviations, is_adequate
):
    count, fitted = 800.0, 80.0
    excess, chance = deviations * np.sqrt(2 / count), deviations / np.sqrt(count)
    for chi2, lag1 in ((1 + excess, 0.0), (1.0, chance), (1.0, -0.1 - chance)):
        found = GoodnessOfFit(chi2, lag1, count, fitted, noise_known=True)
        assert found.is_adequate == is_adequate
    assert GoodnessOfFit(9.0, 0.0, count, fitted, noise_known=False).is_adequate


def test_gaps_and_single_samples_count_for_nothing():
    with_gap = RNG.normal(size=(50, 2))
    with_gap[10:20] = np.nan
    goodness = judge([with_gap, np.zeros((1, 2))])
    assert np.isfinite(goodness.lag1)


def test_a_smooth_path_through_noise_leaves_neighbours_a_negative_correlation():
    """Of cosines through noise alone, with a sixth as many numbers as samples."""
    times = np.linspace(0.0, 1.0, 300)
    columns = np.cos(np.pi * np.arange(50) * times[:, None])
    basis, _ = np.linalg.qr(columns)
    noise = RNG.normal(size=(40, 300, 1))
    left = noise - basis @ (basis.T @ noise)
    count = 40 * 300
    goodness = goodness_of_fit(list(left), 1.0, count - 40 * 50.0, noise_known=False)
    assert goodness.num_fitted == 40 * 50
    # what is expected: neighbours of the hat matrix over its complement's trace
    hat = basis @ basis.T
    expected = -np.trace(hat, offset=1) / (300 - 50)
    assert abs(goodness.lag1 - expected) < 4 / np.sqrt(count)
    assert goodness.lag1 < -0.15
    assert goodness.is_adequate
    alternating = [r + 0.7 * (-1.0) ** np.arange(300)[:, None] for r in left]
    assert not goodness_of_fit(
        alternating, 1.2, count - 40 * 50.0, noise_known=False
    ).is_adequate
