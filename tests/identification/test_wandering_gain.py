"""A gain that wanders is found where it is, and nowhere else; bands know of it."""

import dataclasses

import equinox as eqx
import numpy as np
import pytest

from pinav.identification import (
    FrameJitter,
    Rollouts,
    coverage,
    fit_track,
    path_of,
    select_model,
    tracks,
    with_free,
    with_response,
)
from pinav.identification.findings import _wandering
from pinav.identification.forecast import Forecast
from pinav.identification.models import MATRIX, WANDERING_GAIN
from pinav.identification.selection import split
from pinav.trajectories import Trajectories

GAIN, WANDER, MEMORY = 5.0, 0.5, 5.0
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
    return as_track(times, path, {"frequency": frequency, "heading": heading})


def as_track(times, path, commands):
    """Complex positions and commands as a track."""
    recording = Trajectories.from_arrays(
        [times],
        [np.stack([path.real, path.imag], axis=1)],
        channels=("x", "y"),
        commands={name: [values] for name, values in commands.items()},
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
        results.append(
            (*parts, constant, fit_track(parts[0], CANDIDATE, start=constant))
        )
    return results


@pytest.mark.slow
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


def test_bands_of_a_wandering_gain_grow_with_the_speed(fits):
    train, held_out, constant, fit = fits[0]
    jitter = FrameJitter.of(train, path_of(constant))
    both = dataclasses.replace(constant, wandering=fit)
    piece = held_out.pieces[0]
    forecast = Forecast.of(piece, both, jitter)
    np.testing.assert_array_equal(forecast.path, path_of(constant)(piece))
    variances = []
    for of in (constant, both):
        for factor in (1, 2):
            faster = {
                **piece.commands,
                "frequency": factor * piece.commands["frequency"],
            }
            driven = dataclasses.replace(piece, commands=faster)
            forecast = Forecast.of(driven, of, jitter)
            alone = eqx.tree_at(lambda f: f.beyond, forecast, 0 * forecast.beyond)
            variances.append(alone.variance(0, 100).mean() - 2 * jitter.deviation**2)
    # Twice the speed: four times the variance of a gain, less of a driven velocity.
    assert variances[1] / variances[0] < 3 < variances[3] / variances[2]


@pytest.mark.slow
def test_bands_of_a_wandering_gain_hold():
    inside = {"constant": [], "wandering": []}
    for seed in range(1, 5):
        train, held_out = split(robot(WANDER, seed), 0.7)
        constant = fit_track(train, MATRIX)
        fit = fit_track(train, CANDIDATE, start=constant)
        jitter = FrameJitter.of(train, path_of(constant))
        both = dataclasses.replace(constant, wandering=fit)
        for name, one in (("constant", constant), ("wandering", both)):
            rollouts = Rollouts.of(held_out, 10.0)
            inside[name].append(coverage(held_out, rollouts, one, jitter).inside)
    assert 0.8 < np.mean(inside["wandering"]) < 0.98


@pytest.mark.slow
def test_the_selection_allows_for_a_wandering_gain_in_the_bands_alone():
    selection = select_model(robot(WANDER))
    best = selection.best
    assert best.wandering is not None
    assert not {*WANDERING_GAIN} & {*best.candidate.learned}
    row = selection.row(f"{selection.chosen} + wandering gain")
    assert row.log_evidence == best.wandering.log_evidence
    sentence = _wandering(selection)
    assert "of the gain with a memory of" in sentence
    assert sentence.endswith("the bands allow for it.")


@pytest.mark.slow
def test_bands_hold_where_the_test_part_is_faster_and_slips():
    """Trained up to 4 Hz, where nothing slips yet; at 5 Hz the robot loses grip."""
    inside = []
    for seed in range(3):
        times, seen, commands = slipping_robot(seed)
        train, held_out = split(as_track(times, seen, commands), 0.6)
        fit = fit_track(train, with_response(MATRIX, "slipping"))
        jitter = FrameJitter.of(train, path_of(fit))
        assert fit.fastest <= 4
        rollouts = Rollouts.of(held_out, 10.0)
        inside.append(coverage(held_out, rollouts, fit, jitter).inside)
        forecast = Forecast.of(held_out.pieces[0], fit, jitter)
        beyond = np.abs(forecast.beyond[-1]).max()
        assert beyond > 0
        slower = dict(commands, frequency=np.minimum(commands["frequency"], 3.9))
        same = split(as_track(times, seen, slower), 0.6)[1]
        assert not Forecast.of(same.pieces[0], fit, jitter).beyond.any()
    assert np.mean(inside) > 0.75


def slipping_robot(seed):
    """Commands of 1 to 4 Hz and then of 5; the speed falls behind above 4 Hz."""
    random = np.random.default_rng(seed)
    times = np.arange(0, 200.0, 0.1)
    frequency = np.where(times < 120, 2.5 + 1.5 * np.sin(times / 6), 5.0)
    heading = np.cumsum(random.normal(0, 0.15, len(times)))
    speed = GAIN * np.where(frequency > 4, 0.94 * frequency, frequency)
    velocity = speed * np.exp(1j * heading) + 0.5 * wander(random, times, 1.0)
    path = np.concatenate([[0.0], np.cumsum(velocity[:-1]) * 0.1])
    path = path + 0.05 * wander(random, times, 1e-3)
    return times, path, {"frequency": frequency, "heading": heading}
