"""The evidence of columns against dense normal distributions."""

import numpy as np
import pytest

from pinav.fitting.checks.column_evidence import RATIOS, ColumnWeigher

RNG = np.random.default_rng(7)
ROWS = RNG.normal(size=(30, 6))
PRIOR = np.diag(RNG.uniform(0.5, 2.0, 6))
COLUMNS = RNG.normal(size=(30, 4))
SIGMA = 0.3


def weigher(beside=(), **options):
    flat = list(beside) or [np.zeros((30, 0))]
    return ColumnWeigher.of(
        ROWS, COLUMNS, flat, [PRIOR], squares=0.0, count=30, noise=SIGMA, **options
    )


def dense(known=(), normal=(), beside=None):
    """The largest log evidence over the ratios, normal coefficients integrated out."""
    residuals = COLUMNS[:, 0] + COLUMNS[:, list(known)].sum(axis=1)
    added = COLUMNS[:, list(normal)]
    design = np.zeros((30, 0)) if beside is None else np.linalg.qr(beside)[0]
    rows = ROWS - design @ (design.T @ ROWS)  # by which ratios are scaled
    largest = np.linalg.svd(rows @ np.sqrt(PRIOR), compute_uv=False)[0] ** 2
    values = []
    for ratio in largest * RATIOS:
        if ratio < 1e-6 * largest:
            continue  # where dense matrices lose all digits
        covariance = SIGMA**2 * (np.eye(30) + ROWS @ PRIOR @ ROWS.T / ratio)
        covariance += added @ added.T
        precision = np.linalg.inv(covariance)
        block = design.T @ precision @ design
        best = np.linalg.solve(block, design.T @ precision @ residuals)
        rest = residuals - design @ best
        logarithms = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(block)[1]
        free = len(rest) - len(block)
        exponent = rest @ precision @ rest + logarithms + free * np.log(2 * np.pi)
        values.append(-0.5 * exponent)
    return max(values)


@pytest.mark.parametrize(
    ("known", "normal"), [((), ()), ((2,), ()), ((), (1,)), ((), (1, 3))]
)
def test_the_evidence_is_that_of_a_normal_distribution(known, normal):
    fit = weigher().fit(known=np.array(known, int), normal=np.array(normal, int))
    assert fit.log_evidence == pytest.approx(dense(known, normal), rel=1e-9)


def test_a_trajectory_is_predicted_from_the_others():
    """The density of two of three trajectories, and of all, tells that of the third."""
    from scipy.stats import multivariate_normal

    which = np.array([2])
    fit = weigher().fit(known=which)
    covariance = SIGMA**2 * (np.eye(30) + ROWS @ PRIOR @ ROWS.T / fit.ratio)
    residuals = COLUMNS[:, 0] + COLUMNS[:, 2]
    whole = multivariate_normal(np.zeros(30), covariance).logpdf(residuals)
    for index, density in enumerate(weigher().predictions(fit, 3)):
        others = np.delete(np.arange(30), np.arange(10 * index, 10 * index + 10))
        part = multivariate_normal(np.zeros(20), covariance[np.ix_(others, others)])
        assert density == pytest.approx(whole - part.logpdf(residuals[others]))


def test_predictions_are_those_beside_flat_columns():
    """A flat column makes the same of a trajectory, whatever its coefficient is."""
    beside = RNG.normal(size=(30, 1))
    first = weigher([beside])
    moved = ColumnWeigher.of(
        ROWS,
        COLUMNS + 3.0 * beside,
        [beside],
        [PRIOR],
        squares=0.0,
        count=30,
        noise=SIGMA,
    )
    np.testing.assert_allclose(
        first.predictions(first.fit(), 3), moved.predictions(moved.fit(), 3), rtol=1e-4
    )


def test_flat_columns_beside_the_kernels_are_integrated_out():
    beside = RNG.normal(size=(30, 2))
    assert weigher([beside]).fit().log_evidence == pytest.approx(
        dense(beside=beside), rel=1e-9
    )


def test_of_several_sets_beside_the_kernels_the_best_counts():
    sets = [np.zeros((30, 0)), RNG.normal(size=(30, 2))]
    each = [weigher([one]).fit().log_evidence for one in sets]
    assert weigher(sets).fit().log_evidence == max(each)


def test_directions_that_the_data_do_not_see_cost_nothing():
    seen = RNG.normal(size=(30, 1))
    doubled = np.column_stack([seen, 2 * seen, np.zeros(30)])
    one, other = (weigher([flat]).fit().log_evidence for flat in (seen, doubled))
    assert one == pytest.approx(other, rel=1e-12)


def test_a_coefficient_is_found_and_the_noise_with_it():
    clean = ColumnWeigher.of(
        ROWS,
        np.column_stack([-2.5 * COLUMNS[:, 1] + 0.01 * COLUMNS[:, 2], COLUMNS[:, 1]]),
        [np.zeros((30, 0))],
        [PRIOR],
        squares=0.0,
        count=30,
    )
    fit = clean.fit(normal=np.array([1]))
    assert fit.values[0] == pytest.approx(2.5, abs=0.05)
    assert 0.003 < fit.noise < 0.03
