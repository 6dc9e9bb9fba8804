"""Metrics against other implementations and closed forms."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from tests.navigation.steering_worlds import AHEAD, open_water
from tests.refusals import refusals

from pinav.errors import InputError
from pinav.navigation.task.task import FollowPath, LinePath, ReachGoal
from pinav.navigation.trials import metrics
from pinav.navigation.trials.closed_loop import Episodes, run_many

KEYS = jax.random.split(jax.random.key(0), 4)


@pytest.mark.parametrize(("successes", "count"), [(0, 7), (95, 100), (3, 3), (1, 2)])
def test_interval_of_a_proportion_is_that_of_wilson(successes, count):
    interval = metrics.proportion(successes, count)
    wilson = scipy.stats.binomtest(successes, count).proportion_ci(method="wilson")
    assert interval.value == successes / count
    np.testing.assert_allclose([interval.lower, interval.upper], wilson, atol=1e-12)


test_a_share_that_is_none_is_refused = refusals(
    (lambda: metrics.proportion(3, 2), "proportion: expected .* got 3 of 2"),
    (lambda: metrics.proportion(-1, 2), "proportion: expected .* got -1 of 2"),
    (lambda: metrics.proportion(0, 0), "proportion: expected .* got 0 of 0"),
)


def test_the_interval_of_a_median_holds_it_as_often_as_it_says():
    samples = np.random.default_rng(1).exponential(size=(4000, 25))
    intervals = [metrics.median(sample) for sample in samples]
    inside = np.mean([i.lower <= math.log(2) <= i.upper for i in intervals])
    assert 0.95 <= inside <= 0.98  # between order statistics, so at least 95 %
    assert all(i.lower <= i.value <= i.upper for i in intervals)
    few = metrics.median(np.array([2.0, 1.0, 3.0]))
    assert (few.lower, few.value, few.upper) == (1.0, 2.0, 3.0)


def episodes_that_took(times):
    times = np.asarray(times)
    many, arrived = len(times), np.isfinite(times)
    return Episodes(
        ts=np.zeros(2),
        states=np.zeros((many, 2, 2)),
        commands=np.zeros((many, 1, 2)),
        steps=np.ones(many, int),
        reached=arrived,
        violated=~arrived,
        arrival_time=times,
        clearance=np.zeros(many),
        compute=np.zeros(0),
    )


def test_regret_counts_failures_of_the_learned_and_drops_those_of_the_oracle():
    oracle = episodes_that_took([2.0, 4.0, math.inf, 5.0])
    found = metrics.regret(episodes_that_took([3.0, 4.0, 1.0, math.inf]), oracle)
    assert found.value == 1.5
    assert found.lower == 1.0
    assert found.upper == math.inf
    assert metrics.regret(oracle, oracle).value == 1.0


def test_regret_needs_pairs_and_an_oracle_that_arrives():
    two, none = episodes_that_took([1.0, 2.0]), episodes_that_took([math.inf] * 2)
    with pytest.raises(InputError, match="as many episodes of both, got 2 and 1; run"):
        metrics.regret(two, episodes_that_took([1.0]))
    with pytest.raises(InputError, match="the oracle never arrived, so that there is"):
        metrics.regret(two, none)


def test_summary_of_a_straight_run():
    task = open_water(objective=ReachGoal([1.0, 0.0], 0.25))
    found = metrics.summary(run_many(task, AHEAD, KEYS), task)
    assert (found.runs, found.success.value, found.violation.value) == (4, 1.0, 0.0)
    np.testing.assert_allclose(found.arrival, [0.75] * 3)
    np.testing.assert_allclose(found.efficiency, 1.0)
    np.testing.assert_allclose(found.effort, 0.8)  # eight steps at frequency 1
    np.testing.assert_allclose(found.turning, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.clearance, 99.25)
    assert math.isnan(found.tracking)


def test_summary_of_a_path_that_runs_away():
    """A point at speed 1.5 gains 0.5 on the swimmer in every unit of time."""
    path = FollowPath(LinePath([0.0, 0.0], [3.0, 0.0], 2.0))
    task = open_water(objective=path)
    found = metrics.summary(run_many(task, AHEAD, KEYS), task)
    assert found.success.value == 1.0
    np.testing.assert_allclose(found.tracking, 0.5)
    squares = (0.05 * jnp.arange(21.0)) ** 2
    np.testing.assert_allclose(found.tracking_rms, jnp.sqrt(jnp.mean(squares)))
    assert all(math.isnan(value) for value in found.arrival)


@pytest.mark.parametrize("count", [6, 10, 16, 40])
def test_the_interval_of_a_median_holds_it_with_ninety_five_percent_and_hardly_more(
    count,
):
    """Order statistics l and u of n: the median is between them unless fewer than l
    of n coins, or u or more, fall on one side."""
    interval = metrics.median(np.arange(1.0, count + 1))
    for closer, is_held in ((0, True), (1, False)):
        low, high = interval.lower + closer, interval.upper - closer
        coins = scipy.stats.binom(count, 0.5)
        held = coins.cdf(high - 1) - coins.cdf(low - 1)
        assert (held >= 0.95) == is_held
