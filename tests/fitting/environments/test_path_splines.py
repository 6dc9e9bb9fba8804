import numpy as np
import pytest
from numpy.polynomial import Polynomial
from tests.fitting.problems import STATES, beginning

from pinav.fitting import substeps_for
from pinav.fitting.environments.rates import (
    observed_rates,
    path_spline,
    quadrature_error,
)
from pinav.trajectories import Trajectories


def observe(curves, times):
    slopes = [curve.deriv() for curve in curves]
    states = np.stack([curve(times) for curve in (*curves, *slopes)], axis=1)
    return Trajectories.from_arrays([times], [states], channels=STATES)


def oscillate(interval):
    """Six periods of a circle."""
    times = np.arange(0.0, 12 * np.pi, interval)
    waves = [np.cos(times), np.sin(times), -np.sin(times), np.cos(times)]
    return Trajectories.from_arrays(times, np.stack(waves, axis=1), channels=STATES)


def path_of(data):
    path = path_spline(data.trajectory(0), dim=2)
    assert path is not None
    return path


def test_polynomials_of_degree_seven_are_their_own_splines():
    rng = np.random.default_rng(0)
    curves = [Polynomial(rng.normal(size=8)) for _ in range(2)]
    times = np.sort(rng.uniform(-1.0, 1.0, 9))
    rates = observed_rates(observe(curves, times))
    assert rates is not None
    assert len(rates.times) == 2 * len(times) - 1
    for order, values in ((0, rates.states), (1, rates.rates)):
        for i, curve in enumerate((*curves, *(c.deriv() for c in curves))):
            exact = curve.deriv(order)(rates.times) if order else curve(rates.times)
            np.testing.assert_allclose(values[:, i], exact, atol=1e-8)


def test_slopes_tell_of_an_oscillation_that_has_four_samples_a_period():
    data = oscillate(np.pi / 2)
    path = path_of(data)
    inside = np.linspace(8.0, 28.0, 50)
    exact = -np.stack([np.cos(inside), np.sin(inside)], axis=1)
    missed = np.abs(path.rates(inside)[:, 2:] - exact).max()
    assert missed < 0.01
    assert path.doubts(inside).max() > missed, "the doubt covers the error"


def test_the_doubts_of_dense_samples_are_those_of_splines_through_velocities():
    path = path_of(oscillate(0.1))
    assert path.doubts(path.times[10:-10]).max() < 1e-8


def test_first_order_states_and_few_samples():
    alone = oscillate(0.1).only(STATES[:2])
    rates = observed_rates(alone)
    assert rates is not None
    np.testing.assert_allclose(rates.rates[:, 1], np.cos(rates.times), atol=1e-6)
    few = beginning(alone, 5)
    assert observed_rates(few) is None
    assert substeps_for(few) == 1


def test_rates_that_are_cubics_in_time_need_no_substeps():
    curves = [Polynomial([1.0, 2.0, 0.5, -0.3]), Polynomial([0.0, -1.0, 0.2, 0.1])]
    data = observe(curves, np.linspace(0.0, 2.0, 12))
    assert quadrature_error(path_of(data)) < 1e-10


@pytest.mark.parametrize(("interval", "substeps"), [(0.1, 1), (0.8, 2), (1.6, 4)])
def test_steps_are_as_fine_as_the_path_asks_for(interval, substeps):
    assert substeps_for(oscillate(interval)) == substeps


def test_a_sample_of_which_a_channel_was_lost_is_left_out():
    data = oscillate(0.5)
    observed = np.ones(data.states[0].shape, bool)
    observed[7, 2] = False
    states = np.where(observed, data.states[0], 9.0)
    path = path_of(
        Trajectories.from_arrays(
            data.times, states[None], channels=STATES, observed=observed[None]
        )
    )
    np.testing.assert_allclose(path.times, np.delete(data.times[0], 7))
    np.testing.assert_allclose(
        path.states(data.times[0])[7], data.states[0, 7], atol=1e-4
    )
