import numpy as np
import pytest
from scipy.signal import savgol_filter

from pinav.errors import InputError
from pinav.trajectories import Trajectories, local_polynomial, smooth_states

RNG = np.random.default_rng(0)
NAMES = ("x", "y", "vx", "vy")
EVERYTHING = np.ones(30, bool)


@pytest.mark.parametrize("order", [0, 1])
def test_on_regular_data_it_is_the_savitzky_golay_filter(order):
    times, values = 0.1 * np.arange(30), RNG.normal(size=30)
    found = local_polynomial(times, values, EVERYTHING, order)
    expected = savgol_filter(values, 11, 3, deriv=order, delta=0.1)
    np.testing.assert_allclose(found, expected, atol=1e-10)


def test_a_cubic_is_kept_at_irregular_times_and_across_gaps():
    times = np.cumsum(RNG.uniform(0.05, 0.3, 30))
    observed = EVERYTHING.copy()
    observed[[0, 3, 12, 13, 14, 15, 29]] = False
    values = np.where(observed, times**3 - 2 * times, np.nan)
    value = local_polynomial(times, values, observed)
    slope = local_polynomial(times, values, observed, 1)
    np.testing.assert_allclose(value, times**3 - 2 * times, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(slope, 3 * times**2 - 2, rtol=1e-8)


def trajectory(observed, times=None):
    times = 0.1 * np.arange(30) if times is None else times
    line = np.stack([times, -times, np.ones(30), -np.ones(30)], axis=1)
    return Trajectories.from_arrays(
        [times, times[:8]],
        [line, line[:8]],
        channels=NAMES,
        observed=[observed, observed[:8]],
    )


def test_velocities_never_seen_come_from_positions_and_padding_repeats():
    observed = np.tile([True, True, False, False], (30, 1))
    states = smooth_states(trajectory(observed))
    np.testing.assert_allclose(states[0, :, 2:], [[1.0, -1.0]] * 30, atol=1e-9)
    np.testing.assert_array_equal(states[1, 8:], [states[1, 7]] * 22)


def test_channels_with_too_few_observations_are_refused():
    observed = np.tile([True, False, True, True], (30, 1))
    with pytest.raises(InputError, match="channel 'y' of trajectory 0: 0 obs.* of 'y'"):
        smooth_states(trajectory(observed))
    observed = np.zeros((30, 4), bool)
    observed[:, 0] = True
    observed[:2, 1] = True
    with pytest.raises(InputError, match="channel 'vy' of trajectory 0: 2 obs"):
        smooth_states(trajectory(observed))
