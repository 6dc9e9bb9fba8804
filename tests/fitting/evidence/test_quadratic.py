"""Flat parameters eliminated from random quadratics, against dense algebra."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from tests.fitting.problems import quadratic_of

from pinav.fitting.evidence.quadratic import eliminate_flat, joint_posterior


@given(
    seed=st.integers(0, 2**32 - 1), flat=st.integers(0, 4), weights=st.integers(1, 5)
)
@settings(max_examples=30)
def test_elimination_is_the_dense_solution(seed, flat, weights):
    rng = np.random.default_rng(seed)
    count = flat + weights
    rows, data = rng.normal(size=(40, count)), rng.normal(size=40)
    point = rng.normal(size=count)
    mask = rng.permutation(np.arange(count) < flat)
    whole = quadratic_of(rows, data, point)
    reduced, block = eliminate_flat(whole, mask)
    # the least sum of squares, and where it is, for the weights at their best
    best = np.linalg.lstsq(rows, data, rcond=None)[0]
    change = np.linalg.solve(reduced.hessian, -reduced.gradient)
    mean, covariance = joint_posterior(
        block, reduced.point + change, np.linalg.inv(reduced.hessian), 1.0
    )
    np.testing.assert_allclose(mean, best, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(
        covariance, np.linalg.inv(whole.hessian), rtol=1e-6, atol=1e-9
    )
    least = reduced.squares + reduced.gradient @ change
    assert least == pytest.approx(np.sum((rows @ best - data) ** 2), rel=1e-8)
    determinant = reduced.log_determinant + np.linalg.slogdet(reduced.hessian)[1]
    assert determinant == pytest.approx(np.linalg.slogdet(whole.hessian)[1], rel=1e-8)
    assert reduced.num_free == 40 - flat
