import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.dynamics import Swimmer
from pinav.errors import InputError
from pinav.evaluation import (
    CalibrationOutcome,
    calibrate,
    least_count,
    rollout_bands,
    trajectory_scores,
)
from pinav.fitting import Posterior
from pinav.fitting.engine.local_model import ravel_model
from pinav.forces import LinearDrag, ZeroForce
from pinav.trajectories import Trajectories

CHANNELS = ("x", "vx")


def trajectories(states, **options):
    lengths = [len(own) for own in states]
    times = [0.5 * np.arange(length) for length in lengths]
    return Trajectories.from_arrays(times, states, channels=CHANNELS, **options)


@pytest.mark.parametrize(("count", "miscoverage"), [(19, 0.05), (12, 0.1), (30, 0.3)])
def test_a_new_score_is_covered_as_often_as_the_finite_sample_law_says(
    count, miscoverage
):
    """For continuous scores exactly rank / (n + 1), whatever their distribution."""
    rng = np.random.default_rng(0)
    draws = 4000
    scores = rng.exponential(size=(draws, count + 1)) ** 3
    covered = sum(row[-1] <= calibrate(row[:-1], miscoverage).radius for row in scores)
    law = np.ceil((count + 1) * (1 - miscoverage) - 1e-9) / (count + 1)
    assert law >= 1 - miscoverage
    assert abs(covered - draws * law) < 4 * np.sqrt(draws * law * (1 - law))


def test_the_radius_is_an_order_statistic_and_grows_with_confidence():
    for count in range(1, 400):
        scores = np.arange(1.0, count + 1)
        for percent in (1, 5, 10, 30, 50):
            rank = -(-(count + 1) * (100 - percent) // 100)
            expected = rank if rank <= count else np.inf
            assert calibrate(scores, percent / 100).radius == expected
    scores = np.random.default_rng(1).exponential(size=50)
    levels = (0.5, 0.3, 0.1, 0.05, 0.01)
    radii = [calibrate(scores, level).radius for level in levels]
    assert radii == sorted(radii)
    assert calibrate(2 * scores, 0.1).radius == 2 * calibrate(scores, 0.1).radius
    worse = np.append(scores, np.inf)
    assert calibrate(worse, 0.1).radius >= calibrate(scores, 0.1).radius


@pytest.mark.parametrize("miscoverage", [0.5, 0.1, 0.05, 0.01])
def test_too_few_trajectories_bound_nothing_and_say_how_many_would(miscoverage):
    enough = least_count(miscoverage)
    assert calibrate(np.ones(enough), miscoverage).radius == 1.0
    assert least_count(0.05) == 19
    few = calibrate(np.ones(8), 0.1)
    assert few.radius == np.inf
    assert few.outcome is CalibrationOutcome.TOO_FEW
    assert "8 calibration trajectories are too few, 9 are needed" in str(few)


def test_diverged_predictions_are_borne_up_to_the_miscoverage():
    scores = np.append(np.ones(18), np.inf)
    assert calibrate(scores, 0.1).outcome is CalibrationOutcome.BOUNDED
    assert "1 standard deviations hold 90 %" in str(calibrate(scores, 0.1))
    lost = calibrate(scores, 0.05)
    assert lost.outcome is CalibrationOutcome.DIVERGED
    assert lost.radius == np.inf
    assert "diverged" in str(lost)


def test_a_score_is_the_largest_error_among_what_was_observed():
    states = [np.zeros((4, 2)), np.zeros((2, 2)), np.zeros((4, 2))]
    observed = [np.ones_like(own, bool) for own in states]
    observed[0][3] = False
    data = trajectories(states, observed=observed)
    predictions, sd = np.zeros_like(data.states), np.ones_like(data.states)
    predictions[0, :, 0] = [1.0, -3.0, 2.0, 9.0]
    predictions[1, 2:] = np.nan
    predictions[2, 3, 1] = np.nan
    sd[0, 1] = 2.0
    scores = trajectory_scores(data, predictions, sd)
    np.testing.assert_array_equal(scores, [2.0, 0.0, np.inf])
    early = trajectory_scores(data, predictions, sd, horizon=0.5)
    np.testing.assert_array_equal(early, [1.5, 0.0, 0.0])
    tight = calibrate(np.array([1.0, 2.0]), 0.4)
    inside = tight.covers(data, predictions, sd)
    np.testing.assert_array_equal(inside, [True, True, False])


def test_mistakes_are_named():
    data = trajectories([np.zeros((3, 2)), np.zeros((3, 2))])
    zeros, ones = np.zeros_like(data.states), np.ones_like(data.states)
    with pytest.raises(InputError, match=r"predictions: expected shape \(2, 3, 2\)"):
        trajectory_scores(data, zeros[:, :1], ones[:, :1])
    with pytest.raises(InputError, match="sd: expected > 0 at every observed sample"):
        trajectory_scores(data, zeros, zeros)
    unseen = trajectories([np.zeros((3, 2))], observed=[np.arange(3)[:, None] > [0, 0]])
    with pytest.raises(InputError, match="trajectory 0: no observed sample within"):
        trajectory_scores(unseen, zeros[:1], ones[:1], horizon=0.1)
    for scores in (np.array([]), np.array([1.0, np.nan]), np.array([-1.0])):
        with pytest.raises(InputError, match="scores: expected one number >= 0"):
            calibrate(scores)
    for miscoverage in (0.0, 1.0, float("nan")):
        with pytest.raises(InputError, match="miscoverage: expected a number between"):
            calibrate(np.ones(3), miscoverage)
        with pytest.raises(InputError, match="miscoverage: expected a number between"):
            least_count(miscoverage)


DAMPING, NOISE = 0.5, 0.05


def coasting(damping=DAMPING, sd=0.02):
    """A swimmer that only slows down, its damping known to `sd`."""
    swimmer = Swimmer(ZeroForce(), LinearDrag(jnp.asarray(damping)), ZeroForce())
    free, theta = ravel_model(swimmer, lambda m: m.drag.damping)
    return Posterior(free, np.asarray(theta), np.array([[sd**2]]))


def bands(posterior, data):
    """Rollouts from noisy first samples, and the deviations of what is observed."""
    found = rollout_bands(posterior, data, noise=NOISE)
    return found.ys, found.observable_sd(NOISE)


def observed_coasting(count, seed):
    """Noisy samples of the closed-form solution from random starts."""
    rng = np.random.default_rng(seed)
    times = 0.5 * np.arange(9)
    fade = np.exp(-DAMPING * times)
    x, v = rng.normal(size=(2, count, 1))
    states = np.stack([x + v * (1 - fade) / DAMPING, v * fade], axis=-1)
    return trajectories(list(states + NOISE * rng.normal(size=states.shape)))


@pytest.mark.parametrize("damping", [DAMPING, 0.1], ids=["right", "wrong"])
def test_calibrated_bands_hold_new_trajectories_even_of_a_wrong_model(damping):
    posterior = coasting(damping)
    held_out, new = observed_coasting(39, 0), observed_coasting(200, 1)
    scores = trajectory_scores(held_out, *bands(posterior, held_out))
    found = calibrate(scores, 0.1)
    inside = found.covers(new, *bands(posterior, new))
    # Given the calibration, coverage has a beta distribution: sd 0.05 here.
    assert inside.mean() > 0.9 - 3 * 0.05
    assert found.radius > (2.0 if damping == DAMPING else 4.0)


@pytest.mark.parametrize("damping", [-1e200, np.nan])
def test_a_rollout_that_blows_up_scores_infinity(damping):
    data = observed_coasting(2, 0)
    wild = eqx.tree_at(lambda p: p.mean, coasting(), np.array([damping]))
    scores = trajectory_scores(data, *bands(wild, data))
    np.testing.assert_array_equal(scores, np.inf)
