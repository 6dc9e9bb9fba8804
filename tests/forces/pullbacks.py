"""The law of every prior's `pullback`: it is that of its covariance."""

import numpy as np


def check_pullback(prior, shape, step=1e-5):
    """Compare it with differences of the covariance, for some symmetric matrix."""
    count = len(prior.covariance(shape))
    pull = np.random.default_rng(0).normal(size=(count, count))
    pull += pull.T

    def value(at):
        return np.vdot(pull, prior.covariance(at))

    expected = [
        (value(shape + unit) - value(shape - unit)) / (2 * step)
        for unit in step * np.eye(len(shape))
    ]
    scale = np.abs(expected).max(initial=1.0)
    np.testing.assert_allclose(
        prior.pullback(shape, pull), expected, rtol=1e-6, atol=1e-7 * scale
    )
