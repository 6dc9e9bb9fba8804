"""Judgements of a fit on either side of their limits, and forces of a command alone."""

import numpy as np
import pytest
from tests.samples import stand_in

from pinav.dynamics import Outcome, OverdampedSwimmer
from pinav.evaluation.coverage import inside_band, normal_interval, wandering_variance
from pinav.evaluation.evaluation import Evaluation
from pinav.evaluation.rollouts import (
    RolloutErrors,
    RolloutSummary,
    error_curve,
    mean_errors,
    summarise,
)
from pinav.evaluation.scores import score
from pinav.forces import ZeroForce
from pinav.systems.system import WanderingVelocity
from pinav.trajectories import Trajectories
from pinav.trajectories.trajectory import Trajectory


def test_a_command_makes_a_swimmer_wander_while_it_acts():
    times = np.arange(9.0)
    frequency = np.where(times == 4, 1.0, 0.0)
    states = np.zeros((9, 2))
    piece = Trajectory(times, states, np.ones((9, 2), bool), {"frequency": frequency})
    still = OverdampedSwimmer(ZeroForce(), ZeroForce(), 1.0)
    wandering = WanderingVelocity(still=1e-6, driven=0.5, memory=0.2)
    variance = wandering_variance(still, wandering, piece, states, 1)
    assert np.allclose(variance[:5], 0.0, atol=1e-8)
    # Of a velocity over one unit of time, begun in its steady state.
    expected = 2 * 0.25 * 0.2**2 * (1 / 0.2 - 1 + np.exp(-1 / 0.2))
    assert np.allclose(variance[5:], expected, rtol=1e-5)


def test_a_band_holds_its_edge():
    low, high = normal_interval(np.array([1.0]), np.array([2.0]))
    inside = inside_band(
        np.array([high[0] - 1.0, high[0] - 0.999, np.nan]), np.full(3, 2.0)
    )
    assert inside.tolist() == [True, False, False]
    assert np.isclose(1.0 - low, high - 1.0)


@pytest.mark.parametrize(("median", "worse"), [(1.09, ()), (1.11, ("ude",))])
def test_a_model_is_worse_than_physics_beyond_a_tenth(median, worse):
    def summary(value):
        return {
            "data": {
                "within the training horizon": stand_in(RolloutSummary, median=value)
            }
        }

    found = stand_in(
        Evaluation, rollouts={"ude": summary(median), "physics-only": summary(1.0)}
    )
    assert found.worse_than_physics == worse


def rollout_errors():
    elapsed = np.tile([0.0, 1.0, 2.0, 3.0], (2, 1))
    distance = np.array([[0.0, 1.0, 2.0, 3.0], [0.0, 2.0, 4.0, np.inf]])
    scored = np.ones((2, 4), bool)
    scored[0, 1] = False
    return RolloutErrors(elapsed, distance, 10 * elapsed, scored, 5.0)


def test_rollouts_are_summarised_before_and_after_a_time():
    errors = rollout_errors()
    until = summarise(errors, until=2.0)
    assert np.isclose(until.median, np.sqrt(4 / 2))
    assert np.isclose(until.high, np.sqrt(20 / 3))
    assert np.isclose(until.median_relative, np.sqrt(4 / 2) / 20)
    assert until.diverged == 0.0
    after = summarise(errors, after=2.0)
    assert (after.median, after.high, after.diverged) == (3.0, np.inf, 0.5)
    assert after.trajectories == 2
    curve = error_curve(errors, bins=3)
    assert np.allclose(curve.elapsed, [1 / 3, 2.0, 3.0])
    chosen = errors.elapsed == 2.0
    assert np.allclose(curve.diverged, [0, 0, 0.5])
    assert np.allclose(mean_errors(errors, chosen), [2.0, 4.0])


def test_scores_are_root_mean_squares_of_what_was_observed():
    data = Trajectories.from_arrays(
        np.arange(3.0),
        [np.zeros((3, 2))],
        channels=("x", "v"),
        observed=[np.array([[1, 1], [1, 0], [1, 0]], bool)],
    )
    predicted = np.array([[[0.0, 2.0], [3.0, 9.0], [6.0, 9.0]]])
    found = score(predicted, (Outcome.SUCCESS,), data)
    assert np.allclose(found.rmse, [np.sqrt(15), 2.0])
    assert np.isclose(found.total, np.sqrt((15 + 4) / 2))
    assert np.isclose(found.position, np.sqrt(15))
