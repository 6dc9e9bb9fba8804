"""A belief that begins with the force of a fit: closed forms, and a fit that is off."""

import dataclasses

import numpy as np
import pytest

from pinav.codec import encode
from pinav.navigation.belief.belief import Belief, Frame
from pinav.navigation.belief.given import BeliefPrior, CorrectedForce, GivenForce
from pinav.navigation.belief.motion import OverdampedMotion

LOWER, UPPER = np.zeros(2), np.full(2, 10.0)
AXES = np.linspace(0, 10, 41), np.linspace(0, 10, 41)
SD = 0.1
"""Standard deviation of the error of the fit at each place."""


def uniform(x, y):
    return GivenForce.of(AXES, np.broadcast_to([x, y], (41, 41, 2)))


def swirling():
    x, y = np.meshgrid(*AXES, indexing="ij")
    return GivenForce.of(AXES, np.stack([np.sin(y / 3), np.cos(x / 2)], axis=-1))


def nothing_known():
    first = Frame(0.0, np.array([2.0, 5.0]), 0.02, np.zeros(2))
    return Belief.start(
        first, lower=LOWER, upper=UPPER, motion=OverdampedMotion(0.02), thrust=1.0
    )


def prior(force, places):
    places = np.array(places, float)
    return BeliefPrior(force, places, SD**2 * np.eye(2 * len(places)))


@pytest.fixture(scope="module")
def begun():
    return prior(swirling(), [[2.0, 5.0], [2.5, 5.5]]).lead(nothing_known())


def test_the_fitted_force_is_the_first_guess_everywhere(begun):
    points = np.array([[1.3, 2.2], [5.0, 5.0], [8.8, 1.1]])
    mean, _ = begun.force(points)
    x, y = swirling().splines
    np.testing.assert_allclose(mean, np.stack([x.ev(*points.T), y.ev(*points.T)], 1))
    axes = np.linspace(1, 9, 5), np.linspace(2, 8, 4)
    corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    on_axes = begun.force_on(axes)
    flat = begun.force(corners.reshape(-1, 2))[0]
    np.testing.assert_allclose(on_axes.reshape(-1, 2), flat, atol=1e-12)


def test_the_spread_is_that_of_a_fit_where_it_had_data_and_of_nobody_elsewhere():
    """With one place the variance is s^2 c^2 / (s^2 + c^2), as of two measurements."""
    place = np.array([[5.0, 5.0]])
    believed = prior(uniform(0.3, 0.0), place).lead(nothing_known())
    corrected = believed.best.kernels
    assert isinstance(corrected, CorrectedForce)
    same = [f for f in believed.filters[1:] if f.kernels is corrected.kernels]
    assert len(same) == 1
    unknown = same[0].force(place)[1]
    expected = unknown * SD / np.hypot(unknown, SD)
    np.testing.assert_allclose(believed.force(place)[1], expected, rtol=1e-5)
    far = np.array([[0.0, 10.0]])
    np.testing.assert_allclose(believed.force(far)[1], same[0].force(far)[1], rtol=1e-2)


def test_corrected_kernels_are_kernels(begun):
    kernels = begun.best.kernels
    assert isinstance(kernels, CorrectedForce)
    x, step = np.array([4.2, 5.7]), 1e-5
    local, basis = kernels.at(x), kernels.basis(x[None])[0]
    np.testing.assert_allclose(local.basis, basis[:, local.weights], atol=1e-12)
    for axis, shift in enumerate(step * np.eye(2)):
        ahead, behind = kernels.basis(x + np.stack([shift, -shift]))[..., local.weights]
        slope = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(local.slope[:, axis], slope, atol=1e-7)


def fly_straight(belief):
    """A swimmer of speed one to the right in a uniform current."""
    random = np.random.default_rng(1)
    for k in range(1, 40):
        place = np.array([2.0, 5.0]) + 0.1 * k * (np.array([1.0, 0.0]) + CURRENT)
        seen = place + 0.02 * random.normal(size=2)
        belief = belief.after(Frame(0.1 * k, seen, 0.02, np.array([1.0, 0.0])))
    return belief


def tracked(begin, end, count):
    """Places of data along a line."""
    return np.stack([np.linspace(begin, end, count), np.full(count, 5.0)], axis=1)


CURRENT = np.array([0.3, 0.2])


def test_a_fit_that_is_right_leads_on():
    right = prior(uniform(*CURRENT), tracked(2, 6, 9))
    believed = fly_straight(right.lead(nothing_known()))
    assert believed.leader == 0
    mean, sd = believed.force(np.array([[4.0, 5.4]]))
    np.testing.assert_allclose(mean[0], CURRENT, atol=0.05)
    assert np.all(sd < SD)


def test_a_fit_that_is_no_longer_right_is_given_up():
    wrong = prior(uniform(-0.8, 0.0), tracked(0, 10, 21))
    wrong = dataclasses.replace(wrong, covariance=wrong.covariance / 100)
    believed = fly_straight(wrong.lead(nothing_known()))
    assert believed.leader > 0
    mean, _ = believed.force(np.array([[4.0, 5.4]]))
    np.testing.assert_allclose(mean[0], CURRENT, atol=0.1)


def test_a_belief_with_a_given_force_is_not_stored(begun):
    with pytest.raises(TypeError, match="a file cannot hold a RectBivariateSpline"):
        encode(begun)
