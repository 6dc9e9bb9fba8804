"""A gain that wanders is found where it is, and nowhere else; bands know of it."""

import numpy as np
import pytest

from pinav.identification import (
    FrameJitter,
    Rollouts,
    coverage,
    fit_track,
    path_of,
    tracks,
    with_free,
)
from pinav.identification.forecast import Forecast
from pinav.identification.models import MATRIX, WANDERING_GAIN
from pinav.identification.selection import split
from pinav.trajectories import Trajectories

GAIN, WANDER, MEMORY = 5.0, 1.0, 30.0
CANDIDATE = with_free(MATRIX, "wandering gain", *WANDERING_GAIN)


def wander(random, times, memory):
    """A complex Ornstein-Uhlenbeck process whose parts have variance 1."""
    kicks = random.normal(size=len(times)) + 1j * random.normal(size=len(times))
    decay = np.exp(-(times[1] - times[0]) / memory)
    values = [kicks[0]]
    for kick in kicks[1:]:
        values.append(decay * values[-1] + np.sqrt(1 - decay**2) * kick)
    return np.array(values)


def robot(wandering, seed=0, duration=240.0):
    """A linear robot under random commands whose gain and heading may wander."""
    random = np.random.default_rng(seed)
    times = np.arange(0, duration, 0.1)
    frequency = 2 + np.sin(times / 5)
    heading = np.cumsum(random.normal(0, 0.15, len(times)))
    gain = GAIN + wandering * wander(random, times, MEMORY)
    velocity = gain * frequency * np.exp(1j * heading)
    velocity = velocity + 0.3 * wander(random, times, 1.0) + 0.4
    path = np.concatenate([[0.0], np.cumsum(velocity[:-1]) * 0.1])
    path = path + 0.05 * wander(random, times, 1e-3)
    recording = Trajectories.from_arrays(
        [times],
        [np.stack([path.real, path.imag], axis=1)],
        channels=("x", "y"),
        commands={"frequency": [frequency], "heading": [heading]},
        units={"x": "um", "y": "um", "t": "s"},
    )
    return tracks(recording)[0]


@pytest.fixture(scope="module")
def fits():
    """Training and test part, fit with a constant gain, and with one that wanders."""
    results = []
    for wandering in (WANDER, 0.0):
        parts = split(robot(wandering), 0.7)
        constant = fit_track(parts[0], MATRIX)
        results.append((*parts, constant, fit_track(parts[0], CANDIDATE, start=constant)))
    return results


def test_a_gain_that_wanders_is_found(fits):
    _, _, constant, fit = fits[0]
    assert fit.log_evidence > constant.log_evidence + 20
    found = fit.estimates()
    assert 0.5 * WANDER < found["gain wander"].value < 2 * WANDER
    assert abs(found["gain"].value - GAIN) < 3 * found["gain"].sd
    # What the wandering gain does is no wandering of the velocity.
    assert fit.parameter("log_driven") < constant.parameter("log_driven") - 0.5


def test_a_constant_gain_stays_constant(fits):
    _, _, constant, fit = fits[1]
    assert fit.log_evidence < constant.log_evidence + 1
    assert fit.estimates()["gain wander"].value < 0.1 * GAIN


def test_bands_of_a_wandering_gain_grow_in_proportion_to_the_way(fits):
    train, held_out, _, fit = fits[0]
    jitter = FrameJitter.of(train, path_of(fit))
    forecast = Forecast.of(held_out.pieces[0], fit, jitter)
    variance = forecast.variance(0, 100).mean(axis=1) - jitter.deviation**2
    # Twice the way has four times the variance; a quick velocity makes it twice.
    assert variance[100] > 3 * variance[50]
    # The gain at the end of the training part fades from what is known of it.
    later = forecast.variance(300, 400).mean(axis=1)
    assert later[-1] > variance[100]
    assert forecast.departure[0] < 0.3 < 0.6 < forecast.departure[-1] < 1


def test_bands_of_a_wandering_gain_hold(fits):
    inside = {"constant": [], "wandering": []}
    for seed in range(1, 5):
        train, held_out = split(robot(WANDER, seed), 0.7)
        constant = fit_track(train, MATRIX)
        fit = fit_track(train, CANDIDATE, start=constant)
        for name, one in (("constant", constant), ("wandering", fit)):
            jitter = FrameJitter.of(train, path_of(one))
            rollouts = Rollouts.of(held_out, 10.0)
            inside[name].append(coverage(held_out, rollouts, one, jitter).inside)
    assert 0.8 < np.mean(inside["wandering"]) < 0.98
    assert np.mean(inside["constant"]) < np.mean(inside["wandering"])
