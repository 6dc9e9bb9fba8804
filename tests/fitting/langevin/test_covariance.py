"""Bands of the covariance of blurred increments, and what is computed from them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.fitting.langevin.covariance import (
    Tridiagonal,
    cut,
    factorise,
    increment_bands,
    inverse_bands,
    pull_back,
    score,
    whiten,
)
from pinav.fitting.langevin.increments import Padding

RNG = np.random.default_rng(3)
COUNT = 9
DIFFUSION = RNG.uniform(0.5, 2.0, (COUNT, 1))
INTERVALS = RNG.uniform(0.5, 1.5, (COUNT, 1))
EXPOSURE, VARIANCE = 0.4, 0.3
KEPT = jnp.asarray(RNG.uniform(0.3, 1.0, (COUNT, 1)))


def bands(exposure=EXPOSURE, variance=VARIANCE, share=1.0):
    """Of a diffusion that varies, times a share."""
    diffusion = share * jnp.asarray(DIFFUSION)
    intervals = jnp.asarray(INTERVALS)
    return increment_bands(diffusion, intervals, exposure, variance, KEPT)


def dense(matrix):
    below = np.diag(np.asarray(matrix.beside)[:-1, 0], -1)
    return np.diag(np.asarray(matrix.diagonal)[:, 0]) + below + below.T


def test_blur_and_error_of_equal_intervals_follow_the_law_of_berglund():
    constant, equal = jnp.full((COUNT, 1), 0.7), jnp.full((COUNT, 1), 0.9)
    matrix = increment_bands(constant, equal, EXPOSURE, VARIANCE, jnp.ones((COUNT, 1)))
    share = EXPOSURE / (6 * 0.9)
    variance = 2 * 0.7 * 0.9 * (1 - 2 * share) + 2 * VARIANCE
    np.testing.assert_allclose(matrix.diagonal, variance)
    np.testing.assert_allclose(matrix.beside, 2 * 0.7 * 0.9 * share - VARIANCE)


@pytest.mark.parametrize("rate", [0.0, 0.2, 0.6])
def test_the_law_is_that_of_simulated_paths(rate):
    """Also where a trap of the rate relaxes what a position lacks and errs."""
    from scipy.signal import lfilter

    fine, frames, interval, diffusion = 40, 40_000, 0.9, 0.7
    left = np.exp(-rate * interval / fine)
    kicks = RNG.normal(size=fine * frames) * np.sqrt(2 * diffusion * interval / fine)
    path = lfilter([1.0], [1.0, -left], kicks).reshape(frames, fine)
    seen = path[:, fine // 2 :].mean(axis=1) + 0.5 * RNG.normal(size=frames)
    kept = np.exp(-rate * interval)
    steps = seen[1:] - kept * seen[:-1]
    factor = (1 - kept**2) / (2 * rate * interval) if rate else 1.0
    local, each = jnp.full((3, 1), diffusion * factor), jnp.full((3, 1), interval)
    matrix = increment_bands(local, each, 0.45, 0.25, jnp.full((3, 1), kept))
    assert np.var(steps) == pytest.approx(float(matrix.diagonal[1, 0]), rel=0.025)
    neighbours = np.mean(steps[1:] * steps[:-1])
    assert neighbours == pytest.approx(float(matrix.beside[1, 0]), abs=0.02)


def test_factor_solutions_and_inverse_are_those_of_dense_matrices():
    matrix = bands()
    whole, residuals = dense(matrix), RNG.normal(size=(COUNT, 1))
    factor = factorise(matrix)
    lower = np.linalg.cholesky(whole)
    np.testing.assert_allclose(factor.diagonal[:, 0], np.diag(lower))
    assert float(factor.log_determinant) == pytest.approx(np.linalg.slogdet(whole)[1])
    white = whiten(factor, jnp.asarray(residuals))
    np.testing.assert_allclose(white, np.linalg.solve(lower, residuals))
    solution = np.linalg.solve(whole, residuals)
    np.testing.assert_allclose(pull_back(factor, white), solution)
    inverse, found = np.linalg.inv(whole), inverse_bands(factor)
    np.testing.assert_allclose(found.diagonal[:, 0], np.diag(inverse))
    np.testing.assert_allclose(found.beside[:-1, 0], np.diag(inverse, 1))


@pytest.mark.slow
def test_the_gradient_is_that_of_differences():
    residuals, whole = jnp.asarray(RNG.normal(size=(COUNT, 1))), jnp.ones((COUNT, 1))

    def of(entries):
        return cut(bands(*entries), whole)

    entries = jnp.array([EXPOSURE, VARIANCE, 1.0])
    _, chain = jax.vjp(of, entries)
    (slopes,) = chain(score(of(entries), residuals).by_bands)
    for i, step in enumerate(1e-5 * jnp.eye(3)):
        upper, lower = (score(of(entries + s), residuals) for s in (step, -step))
        change = float(upper.value - lower.value)
        assert float(slopes[i]) == pytest.approx(change / 2e-5, rel=1e-5)


def test_padding_changes_nothing():
    mask = np.ones((COUNT, 1))
    mask[6:] = 0.0
    residuals = RNG.normal(size=(COUNT, 1)) * mask
    cropped = Tridiagonal(bands().diagonal[:6], bands().beside[:6])
    short = score(cut(cropped, jnp.ones((6, 1))), jnp.asarray(residuals[:6]))
    padded = score(cut(bands(), jnp.asarray(mask)), jnp.asarray(residuals))
    assert float(padded.value) == pytest.approx(float(short.value))


def test_padding_puts_tracks_side_by_side_and_back():
    padding = Padding.of((2, 0, 3))
    values = jnp.arange(5.0)
    np.testing.assert_array_equal(padding.flatten(padding.pad(values)), values)
    np.testing.assert_array_equal(padding.mask, [[1, 1], [1, 1], [0, 1]])
