"""Closed forms of costs, times and judgements of a way, and their limits."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.samples import stand_in

from pinav.actuation import LinearResponse, RollingActuator
from pinav.navigation.adaptive.flight import Flight, judge_controllers
from pinav.navigation.adaptive.safety import choose_command, farthest
from pinav.navigation.belief.belief import Belief
from pinav.navigation.control.controller import AbstractController, Observation
from pinav.navigation.control.default import (
    DelayCompensation,
    StateEstimation,
    predict_onset,
)
from pinav.navigation.design.campaign import Campaign, CampaignSummary, Decision
from pinav.navigation.planning.plan import TimeToGo
from pinav.navigation.planning.value_iteration import ArrivalTest
from pinav.navigation.predictors import (
    AbstractPredictor,
    ControlMap,
    OverdampedTable,
    TabulatedModel,
    TimeCost,
    entry_fraction,
)
from pinav.navigation.tables import FieldTable, Grid
from pinav.navigation.task.catalogue import Way
from pinav.navigation.task.steering import CommandLimits, turned_angles
from pinav.navigation.task.task import Disc, ReachGoal, Rectangle, Timing, Wall

ARENA = Rectangle([0.0, 0.0], [10.0, 10.0])
ACTUATOR = RollingActuator(2.0 * jnp.eye(2), LinearResponse())
LIMITS = CommandLimits(1.0)
GRID = Grid.over(ARENA, 11, margin=2)


def test_delays_are_cut_into_whole_steps_and_a_rest():
    for delay, waiting, remainder, rest in (
        (0.0, 1, 0.0, 0.1),
        (0.04, 1, 0.04, 0.06),
        (0.1, 1, 0.1, 0.0),
        (0.25, 3, 0.05, 0.05),
    ):
        timing = Timing(0.1, delay)
        assert timing.waiting == waiting
        assert np.allclose([timing.remainder, timing.rest], [remainder, rest])


def test_distances_are_told_from_the_rim():
    goal = ReachGoal([1.0, 1.0], 0.5)
    assert np.isclose(goal.distance(jnp.array([4.0, 5.0])), 4.5)
    assert bool(goal.is_reached(jnp.array([1.0, 1.49])))
    assert not bool(goal.is_reached(jnp.array([1.0, 1.51])))
    assert np.isclose(Disc([0.0, 0.0], 2.0).distance(jnp.array([3.0, 4.0])), 3.0)
    wall = Wall([0.0, 0.0], [2.0, 0.0], 0.25)
    assert np.isclose(wall.distance(jnp.array([1.0, 1.0])), 0.75)
    assert np.isclose(wall.distance(jnp.array([5.0, 4.0])), 4.75)
    assert np.isclose(ARENA.distance(jnp.array([2.0, 5.0])), -2.0)
    assert np.isclose(ARENA.distance(jnp.array([13.0, 14.0])), 5.0)


def test_commands_turn_as_far_as_they_may():
    before = jnp.array([3.0])
    for wanted, turned in ((3.2, 3.1), (2.0, 2.9), (-3.2, 3.08318531)):
        angles = turned_angles(before, jnp.array([wanted]), jnp.asarray(0.1))
        assert np.isclose(float(angles[0]), turned)
    limits = CommandLimits(2.0, 0.5)
    clipped = limits.clip(jnp.array([3.0, 1.0]), jnp.array([0.0, 0.0]), 0.2)
    assert np.allclose(clipped, [2.0, 0.1])


def test_the_arena_of_a_way_has_a_margin_of_a_quarter_and_the_tolerance():
    way = Way(start=(0.0, 0.0), goal=(3.0, 4.0), tolerance=0.5)
    arena = way._arena(np.array([[-9.0, 0.0], [0.0, 1.0]]))
    assert np.allclose(arena.lower, [-9.0, -1.75])
    assert np.allclose(arena.upper, [4.75, 5.75])


@pytest.fixture(scope="module")
def cost():
    """Time beside a disc, on ground that is the more doubtful the farther along x."""
    lattice = GRID.points[None, ..., :1] / 10
    spread = FieldTable(GRID, lattice)
    zone = Disc([5.0, 5.0], 1.0)
    return TimeCost((zone,), ARENA, 0.5, 4.0, spread, 2.0)


def test_time_costs_more_near_zones_and_on_doubtful_ground(cost):
    x = jnp.array([5.0, 6.25])  # a quarter away from the disc, half of the margin
    assert np.isclose(cost.clearance(x), 0.25)
    assert np.isclose(cost.nearness(jnp.asarray(0.25)), 4 * 0.5**2)
    assert np.isclose(cost.nearness(jnp.asarray(0.5)), 0.0)
    assert np.isclose(cost.risk(0.0, x), 2 * 0.5**2)
    assert np.isclose(cost.running_cost(0.0, x), 1 + 1 + 0.5)
    goal, way = jnp.array([4.0, 0.0]), jnp.array([10.0, 0.0])
    enters = entry_fraction(jnp.zeros(2), way, goal, 1.0)
    assert np.isclose(enters, 0.3)
    assert np.isinf(entry_fraction(jnp.zeros(2), -way, goal, 1.0))
    assert np.isinf(entry_fraction(jnp.zeros(2), way / 4, goal, 1.0))
    assert float(entry_fraction(goal, way, goal, 1.0)) == 0.0


def test_a_leg_is_discounted_by_what_it_costs(cost):
    arrival = ArrivalTest(
        jnp.array([9.0, 9.0]),
        jnp.asarray(0.5),
        cost,
        jnp.zeros((1, 2)),
        jnp.asarray(4.0),
    )
    x, way = jnp.array([5.0, 6.25]), jnp.array([1.0, 0.0])
    places = np.stack([5 + np.array([0.25, 0.75]), np.full(2, 6.25)], axis=1)
    gaps = np.linalg.norm(places - 5, axis=1) - 1
    near = np.mean(4 * np.maximum(0, 1 - gaps / 0.5) ** 2)
    discount, arrives = arrival.leg(x, way, jnp.asarray(0.3), jnp.asarray(0.7))
    assert not bool(arrives)
    assert np.isclose(discount, math.exp(-(1 + near + 0.7) * 0.3 / 4))
    blocked, _ = arrival.leg(
        x, jnp.array([0.0, -1.0]), jnp.asarray(0.3), jnp.asarray(0.0)
    )
    assert float(blocked) == 0.0
    last = jnp.array([9.0, 7.5])
    discount, arrives = arrival.leg(
        last, jnp.array([0.0, 2.0]), jnp.asarray(0.3), jnp.asarray(0.0)
    )
    assert bool(arrives)
    assert np.isclose(discount, math.exp(-0.5 * 0.3 / 4))


def swinging_table():
    """A drift along x that grows with time, by one a unit of time; mobility one."""
    still = np.zeros((3, *GRID.shape, 6))
    still[..., 0] = np.arange(3.0)[:, None, None]
    still[..., 2] = still[..., 5] = 1.0
    return FieldTable(GRID, jnp.asarray(still), 1.0)


def test_a_step_in_a_drift_that_grows_is_its_integral():
    predictor = OverdampedTable(swinging_table(), ACTUATOR)
    moved = predictor.step(
        0.25, jnp.array([5.0, 5.0]), jnp.array([0.5, math.pi / 2]), 0.5
    )
    assert np.allclose(moved, [5 + (0.75**2 - 0.25**2) / 2, 5 + 0.5], atol=1e-6)


def test_a_plan_in_a_flow_that_changes_looks_ahead_by_its_own_step(cost):
    """Before the second moment the goal is nearer on the right, then on the left."""
    x = np.linspace(0, 10, 11)[:, None] * np.ones(11)
    left = np.stack([10 - x, 5 + x, x])
    drive = ControlMap.of(ACTUATOR, LIMITS)
    table = swinging_table()
    still = dataclasses.replace(table, values=table.values.at[..., 0].set(0.0))
    predictor = OverdampedTable(still, ACTUATOR)
    plan = TimeToGo(
        jnp.asarray(np.exp(-left / 2)),
        jnp.zeros(2),
        jnp.ones(2),
        jnp.asarray(2.0),
        jnp.asarray(1.0),
        20.0,
        TabulatedModel(predictor, drive, cost),
        jnp.array([9.0, 9.0]),
        jnp.asarray(0.5),
    )
    here, idle = jnp.array([5.0, 5.0]), jnp.array([0.0, 0.0])
    at = eqx.filter_jit(plan.at)
    assert np.isclose(float(at(here, 0.5)), 7.5, rtol=0.2)
    assert np.isclose(float(at(jnp.array([6.0, 5.0]), 2.0)), 6.0, atol=1e-5)
    assert np.isclose(plan.time_from(jnp.array([6.0, 5.0])), 4.0, atol=1e-5)
    control = eqx.filter_jit(plan.control)(0.0, here, idle, predictor)
    assert np.allclose(control, [-1.0, 0.0], atol=1e-6)


class Drifting(AbstractPredictor):
    """Moves by the command's first number, and drifts apart by its own position."""

    def step(self, t, y, command, duration):
        return y + duration * (command + 0.5 * y)


class Told(AbstractController):
    """Commands where it is told to be."""

    def start(self, observation):
        return observation.state

    def __call__(self, observation, memory, *, key):
        return jnp.append(observation.time, observation.state), observation.state


def test_a_delayed_command_is_chosen_for_the_state_it_will_meet():
    pending = jnp.array([[1.0, 0.0], [0.0, 2.0]])
    timing = Timing(0.1, 0.15)
    seen = Observation(jnp.asarray(1.0), jnp.array([2.0, -1.0]), pending)
    expected = np.array([2.0, -1.0])
    for command, duration in zip(np.asarray(pending), (0.05, 0.1), strict=True):
        expected = expected + duration * (command + 0.5 * expected)
    ahead = predict_onset(Drifting(), timing, seen)
    assert np.isclose(ahead.time, 1.15)
    assert np.allclose(ahead.state, expected)
    assert np.allclose(ahead.pending, pending[-1:])
    steered = DelayCompensation(Told(), Drifting(), timing)
    command, _ = steered(seen, steered.start(seen), key=jax.random.key(0))
    assert np.allclose(command, [1.15, *expected])


def test_an_estimate_is_that_of_the_filter_of_kalman():
    timing = Timing(0.1, 0.04)
    steered = StateEstimation(Told(), Drifting(), timing, noise=0.3, sensor_noise=0.2)
    pending = jnp.array([[1.0, 0.0]])
    first = Observation(jnp.asarray(0.0), jnp.array([2.0, -1.0]), pending)
    command, belief = steered(first, steered.start(first), key=jax.random.key(0))
    assert np.allclose(command[1:], [2.0, -1.0])
    after = jnp.array([[0.0, 3.0]])
    second = Observation(jnp.asarray(0.1), jnp.array([2.5, -0.5]), after)
    command, belief = steered(second, belief, key=jax.random.key(0))
    mean, slope = np.array([2.0, -1.0]), 1.0
    for given, duration in ((np.array([1.0, 0.0]), 0.04), (np.array([0.0, 3.0]), 0.06)):
        mean = mean + duration * (given + 0.5 * mean)
        slope *= 1 + 0.5 * duration
    variance = slope**2 * 0.04 + 0.09 * 0.1
    gain = variance / (variance + 0.04)
    assert np.allclose(
        command[1:], mean + gain * (np.array([2.5, -0.5]) - mean), rtol=1e-4
    )
    assert np.allclose(belief.covariance, variance * (1 - gain) * np.eye(2), rtol=1e-4)


def flight(arrival, **more):
    times = np.array([9.0, 1.0, 3.0])
    return Flight(
        path=np.zeros((2, 2)),
        reached=math.isfinite(arrival),
        violated=False,
        arrival_time=arrival,
        clearance=1.0 + min(arrival, 9.0),
        consistency=1.0,
        changed=2,
        stalls=0,
        learn_times=times,
        command_times=times,
        replan_times=times,
        memory=7,
        force_error=0.1,
        cover=0.9,
        **more,
    )


def test_flights_are_judged_against_those_that_know():
    flights = [flight(a) for a in (10.0, 12.0, math.inf, 9.0)]
    oracle = [flight(a) for a in (8.0, 8.0, 8.0, math.inf)]
    judged = judge_controllers({"oracle": oracle, "visit 1": flights}, 10.0)
    found = judged["visit 1"]
    assert found.success.value == 0.75
    assert found.in_time.value == 0.5
    assert found.regret is not None
    assert found.regret.value == 1.5
    assert found.clearance == 10.0
    assert found.command_time == found.replan_time == 2.0
    assert found.memory == 7.0
    assert judged["oracle"].force_error is None
    assert choose_command(np.array([0.0, 1.0, -0.1]), np.array([1.0, 0.5, 9.0])) == 0
    assert choose_command(np.array([-0.2, -0.1]), np.array([9.0, 0.0])) == 1
    assert np.isclose(farthest(np.array([0.0, 0, 3, 4]), 2.0, 3.0), 15 + 2.5 * 2 * 9)
    assert np.isclose(farthest(np.zeros(2), 2.0, 3.0), 24.0)


def campaign(*errors, accuracy=0.1, paths=None):
    way = np.zeros((2, 2))
    decisions = tuple(
        Decision(way, arrives, bound, true) for arrives, bound, true in errors
    )
    count = len(errors) - 1 if paths is None else paths
    return Campaign(accuracy, (way,) * count, decisions, stand_in(Belief))


def test_campaigns_are_counted_until_they_know():
    right = campaign((True, 0.3, 0.2), (True, 0.2, 0.09), (True, 0.1, 0.1))
    wrong = campaign((True, 0.3, 0.3), (True, 0.09, 0.11))
    given_up = campaign((True, 0.3, 0.3), (True, 0.11, 0.05))
    stuck = campaign((True, 0.3, 0.3), (False, 0.05, 0.05))
    assert [one.finished for one in (right, wrong, given_up, stuck)] == [
        True,
        True,
        False,
        False,
    ]
    assert [one.right for one in (right, wrong, given_up)] == [True, False, None]
    summary = CampaignSummary.of([right, wrong, given_up])
    assert (summary.campaigns, summary.finished, summary.right) == (3, 2, 1)
    assert (summary.trajectories, summary.fewest, summary.largest) == (2.0, 1, 2)
    assert summary.reached == 1.0
    assert CampaignSummary.of([stuck]).reached == math.inf
    assert summary.error == 0.1
