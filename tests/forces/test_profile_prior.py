"""What the floor of a prior leaves where its envelope has ended."""

import numpy as np

from pinav.forces.priors import DistancePrior, WeightPrior

PLACES = np.linspace(0.5, 20.0, 40)[:, None]
FADED = np.array([1.0, 0.5, -19.0])
"""A length scale of 2.7 widths, an envelope of 1.6 at the lower end."""


def test_a_floor_holds_the_variance_where_the_envelope_ends():
    without = WeightPrior(PLACES, 0.5).covariance(FADED)
    with_floor = WeightPrior(PLACES, 0.5, floor=0.1).covariance(FADED)
    assert without[-1, -1] < 1e-12
    np.testing.assert_allclose(with_floor[-1, -1], 0.01, rtol=1e-9)
    np.testing.assert_allclose(with_floor[0, 0], without[0, 0] + 0.01)


def test_slopes_of_a_prior_with_a_floor_are_differences_of_its_covariance():
    prior = DistancePrior(WeightPrior(PLACES, 0.5, floor=0.1))
    shape, step = np.array([1.2, 2.0, -3.0]), 1e-5
    for index, slope in enumerate(prior.slopes(shape)):
        change = step * np.eye(3)[index]
        ends = prior.covariance(shape + change), prior.covariance(shape - change)
        np.testing.assert_allclose(slope, (ends[0] - ends[1]) / (2 * step), atol=1e-8)
