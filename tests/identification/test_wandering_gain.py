"""A gain that wanders is found where it is, and nowhere else; bands know of it."""

import dataclasses

import equinox as eqx
import numpy as np
import pytest
from tests.identification.conftest import as_recording, wander

from pinav.identification import (
    Predictor,
    Rollouts,
    coverage,
    estimates,
    fit_track,
    gain_matrix,
    path_of,
    select_model,
    tracks,
    with_response,
)
from pinav.identification.findings import _wandering
from pinav.identification.parameters import WANDERING_GAIN
from pinav.identification.selection import split

GAIN, WANDER, MEMORY = 5.0, 0.5, 5.0


def complex_wander(random, times, memory):
    """A complex process whose parts have variance 1."""
    kicks = random.normal(size=len(times)) + 1j * random.normal(size=len(times))
    return wander(kicks, times, memory)


def seen(gain, frequency, heading, wandering, random, times):
    """A robot of this gain that wanders, and is seen with an error."""
    velocity = gain * frequency * np.exp(1j * heading)
    velocity = velocity + wandering * complex_wander(random, times, 1.0) + 0.4
    path = np.concatenate([[0.0], np.cumsum(velocity[:-1]) * 0.1])
    return path + 0.05 * complex_wander(random, times, 1e-3)


def robot(wandering, seed=0, duration=240.0):
    """A linear robot under random commands whose gain and heading may wander."""
    random = np.random.default_rng(seed)
    times = np.arange(0, duration, 0.1)
    frequency = 2 + np.sin(times / 5)
    heading = np.cumsum(random.normal(0, 0.15, len(times)))
    gain = GAIN + wandering * complex_wander(random, times, MEMORY)
    path = seen(gain, frequency, heading, 0.3, random, times)
    return as_track(times, path, {"frequency": frequency, "heading": heading})


def as_track(times, path, commands):
    """Complex positions and commands as a track."""
    states = np.stack([path.real, path.imag], axis=1)
    return tracks(as_recording((times, states, commands)))[0]


def evidence(fit):
    """Log evidence of a fit."""
    return fit.hyperparameters.log_evidence


def both_fits(track):
    """The fit with a constant gain, and the one with a gain that wanders."""
    fixed = fit_track(track, gain_matrix())
    return fixed, fit_track(track, gain_matrix(), start=fixed, wandering_gain=True)


@pytest.fixture(scope="module")
def fits():
    """Training and test part, fit with a constant gain, and with one that wanders."""
    parts = [split(robot(wandering), 0.7) for wandering in (WANDER, 0.0)]
    return [(train, held_out, *both_fits(train)) for train, held_out in parts]


@pytest.mark.slow
def test_a_gain_that_wanders_is_found(fits):
    _, _, constant, fit = fits[0]
    assert evidence(fit) > evidence(constant) + 20
    found = estimates(fit)
    assert 0.5 * WANDER < found["gain wander"].value < 2 * WANDER
    assert abs(found["gain"].value - GAIN) < 3 * found["gain"].sd
    # What the wandering gain does is no wandering of the velocity.
    driven = (one.constants["wandering.driven"].value for one in (fit, constant))
    assert next(driven) < np.exp(-0.5) * next(driven)


def test_a_constant_gain_stays_constant(fits):
    _, _, constant, fit = fits[1]
    assert evidence(fit) < evidence(constant) + 1
    assert estimates(fit)["gain wander"].value < 0.1 * GAIN


def test_bands_of_a_wandering_gain_grow_with_the_speed(fits):
    train, held_out, constant, fit = fits[0]
    alone, both = Predictor.of(train, constant), Predictor.of(train, constant, fit)
    piece = held_out.pieces[0]
    path = path_of(constant.model)(piece)
    np.testing.assert_array_equal(both.forecast(piece).path, path)

    def growth(predictor):
        """How the variance grows where the robot is driven twice as fast."""
        variances = []
        for factor in (1, 2):
            faster = piece.commands | {
                "frequency": factor * piece.commands["frequency"]
            }
            forecast = predictor.forecast(dataclasses.replace(piece, commands=faster))
            inner = eqx.tree_at(lambda f: f.beyond, forecast, 0 * forecast.beyond)
            jitter = 2 * predictor.jitter.deviation**2
            variances.append(inner.variance(0, 100).mean() - jitter)
        return variances[1] / variances[0]

    # Twice the speed: four times the variance of a gain, less of a driven velocity.
    assert growth(alone) < 3 < growth(both)


@pytest.mark.slow
def test_bands_of_a_wandering_gain_hold():
    inside = []
    for seed in range(1, 5):
        train, held_out = split(robot(WANDER, seed), 0.7)
        predictor = Predictor.of(train, *both_fits(train))
        rollouts = Rollouts.of(held_out, 10.0)
        inside.append(coverage(held_out, rollouts, predictor).inside)
    assert 0.8 < np.mean(inside) < 0.98


@pytest.mark.slow
def test_the_selection_allows_for_a_wandering_gain_in_the_bands_alone():
    selection = select_model(robot(WANDER))
    assert selection.wandering is not None
    paths = {parameter.path for parameter in WANDERING_GAIN}
    assert not paths & {*selection.best.constants}
    row = selection.row(f"{selection.chosen} + wandering gain")
    assert row.log_evidence == evidence(selection.wandering)
    sentence = _wandering(selection)
    assert "of the gain with a memory of" in sentence
    assert sentence.endswith("the bands allow for it.")


@pytest.mark.slow
def test_bands_hold_where_the_test_part_is_faster_and_slips():
    """Trained up to 4 Hz, where nothing slips yet; at 5 Hz the robot loses grip."""
    inside = []
    for seed in range(3):
        times, path, commands = slipping_robot(seed)
        train, held_out = split(as_track(times, path, commands), 0.6)
        fit = fit_track(train, with_response(gain_matrix(), "slipping"))
        predictor = Predictor.of(train, fit)
        assert predictor.fastest <= 4
        rollouts = Rollouts.of(held_out, 10.0)
        inside.append(coverage(held_out, rollouts, predictor).inside)
        forecast = predictor.forecast(held_out.pieces[0])
        beyond = np.abs(forecast.beyond[-1]).max()
        assert beyond > 0
        slower = dict(commands, frequency=np.minimum(commands["frequency"], 3.9))
        same = split(as_track(times, path, slower), 0.6)[1]
        assert not predictor.forecast(same.pieces[0]).beyond.any()
    assert np.mean(inside) > 0.75


def slipping_robot(seed):
    """Commands of 1 to 4 Hz and then of 5; the speed falls behind above 4 Hz."""
    random = np.random.default_rng(seed)
    times = np.arange(0, 200.0, 0.1)
    frequency = np.where(times < 120, 2.5 + 1.5 * np.sin(times / 6), 5.0)
    heading = np.cumsum(random.normal(0, 0.15, len(times)))
    gain = np.where(frequency > 4, 0.94 * GAIN, GAIN)
    path = seen(gain, frequency, heading, 0.5, random, times)
    return times, path, {"frequency": frequency, "heading": heading}
