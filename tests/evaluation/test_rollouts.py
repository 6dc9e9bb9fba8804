import numpy as np
import pytest

from pinav.errors import InputError
from pinav.evaluation import (
    error_curve,
    position_errors,
    quantile,
    summarise,
    without_first,
)
from pinav.trajectories import Trajectories

TIMES = np.linspace(0.0, 10.0, 101)


def straight(count):
    """Swimmers with speed 2 along x."""
    states = np.stack([2.0 * TIMES, np.zeros_like(TIMES)], axis=1)
    return Trajectories.from_arrays(
        [TIMES] * count, [states] * count, channels=("x", "y")
    )


def test_errors_that_grow_with_time_have_the_quantiles_of_their_rates():
    data = straight(10)
    rates = np.arange(1, 11) / 10
    predictions = data.states.copy()
    predictions[..., 1] = rates[:, None] * data.times
    errors = position_errors(predictions, data)
    np.testing.assert_allclose(errors.path[:, -1], 20.0, rtol=1e-9)
    curve = error_curve(errors, bins=20)
    np.testing.assert_allclose(curve.median, 0.5 * curve.elapsed, atol=0.03)
    np.testing.assert_allclose(curve.high, 0.9 * curve.elapsed, atol=0.06)
    assert not curve.diverged.any()
    whole = summarise(errors)
    rms = np.sqrt(np.mean(TIMES**2))
    assert whole.median == pytest.approx(0.5 * rms)
    assert whole.high == pytest.approx(0.9 * rms)
    assert whole.median_relative == pytest.approx(0.5 * rms / 20.0)
    later = summarise(errors, after=5.0)
    rms = np.sqrt(np.mean(TIMES[51:] ** 2))
    assert later.median == pytest.approx(0.5 * rms)
    early = summarise(errors, until=5.0)
    rms = np.sqrt(np.mean(TIMES[:51] ** 2))
    assert early.median_relative == pytest.approx(0.5 * rms / 10.0)


def test_a_rollout_beyond_the_domain_has_diverged_for_good():
    data = straight(4)
    predictions = data.states.copy()
    predictions[0, 55, 1] = 21.0  # farther than the extent, 20, then back
    predictions[1, 85:] = np.nan
    errors = position_errors(predictions, data)
    assert np.isinf(errors.distance[0, 55:]).all()
    assert not np.isinf(errors.distance[0, :55]).any()
    curve = error_curve(errors, bins=10)
    np.testing.assert_allclose(curve.diverged, [0] * 5 + [0.25] * 3 + [0.5] * 2)
    whole = summarise(errors)
    assert (whole.diverged, whole.median, whole.high) == (0.5, 0.0, np.inf)
    assert summarise(errors, until=4.0).diverged == 0.0
    assert position_errors(predictions, data, domain=30.0).distance[0, 55] == 21.0


def test_what_was_not_observed_is_not_scored():
    data = straight(2)
    observed = np.ones((2, *data.states.shape[1:]), bool)
    observed[1, 30:, 0] = False
    holes = Trajectories.from_arrays(
        list(data.times),
        list(data.states),
        channels=data.channels,
        observed=list(observed),
    )
    predictions = holes.states + np.array([0.0, 0.5])
    predictions[1, 40:] = np.nan
    whole = summarise(position_errors(predictions, holes, domain=20.0))
    assert (whole.diverged, whole.trajectories) == (0.0, 2)
    assert whole.high == pytest.approx(0.5)
    late = summarise(position_errors(predictions, holes, domain=20.0), after=5.0)
    assert late.trajectories == 1
    rest = without_first(data, 90)
    assert position_errors(predictions, rest, domain=20.0).scored.sum() == 2 * 11
    with pytest.raises(InputError, match="no observed position is left to score"):
        position_errors(predictions, without_first(data, 101), domain=20.0)


def test_quantiles_do_not_interpolate():
    values = np.array([1.0, 2.0, np.inf, np.inf])
    assert quantile(values, 0.5) == 2.0
    assert quantile(values, 0.9) == np.inf
    assert np.isnan(quantile(np.zeros(0), 0.5))


def test_noise_hardly_lengthens_the_way():
    data = straight(1)
    random = np.random.default_rng(0)
    noisy = Trajectories.from_arrays(
        TIMES,
        data.states[0] + 0.1 * random.standard_normal((101, 2)),
        channels=("x", "y"),
    )
    chords = np.linalg.norm(np.diff(noisy.states[0], axis=0), axis=1).sum()
    way = position_errors(data.states, noisy).path[0, -1]
    assert chords > 1.2 * 20.0
    assert way == pytest.approx(20.0, rel=0.05)
