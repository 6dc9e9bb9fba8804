"""Learning while steering: strategies, plans from old values, the safety filter."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.navigation.steering_worlds import frame_at, learned, vortex

from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.forces import (
    ConstantDirector,
    ConstantForce,
    TensorDrag,
    UniaxialTensor,
    ZeroForce,
)
from pinav.navigation import Disc, Rectangle, physics_only, task, time_to_go
from pinav.navigation.adaptive.flight import fly
from pinav.navigation.adaptive.prior import with_truth
from pinav.navigation.adaptive.safety import check_command
from pinav.navigation.adaptive.steering import AdaptiveController
from pinav.navigation.adaptive.strategies import (
    MEAN_FORCE,
    ExplorationBonus,
    axes_of,
    mean_and_spread,
    with_known,
)
from pinav.navigation.belief.given import GivenForce, take_for_granted
from pinav.navigation.control.controller import Observation, TrajectoryPrediction
from pinav.navigation.predictors import tabulate_model
from pinav.navigation.task.task import ReachGoal

STRATEGIES = {
    "mean": MEAN_FORCE,
    "bonus": ExplorationBonus(),
    "bold": ExplorationBonus(boldness=2),
}


@pytest.fixture(scope="module")
def adaptive():
    return AdaptiveController.of(vortex(), points=21)


def straight_on(adaptive):
    """A belief after a straight flight through still water."""
    steps = 0.1 * np.arange(1, 15)
    flight = [frame_at(1.0 + t, 5.0, t, thrust=(1.0, 0.0)) for t in steps]
    return learned(adaptive.believe(frame_at(1.0, 5.0)), flight)


@pytest.mark.parametrize("strategy", STRATEGIES.values(), ids=STRATEGIES)
def test_every_strategy_gives_tables_of_one_form(adaptive, strategy):
    tables = strategy.tables(straight_on(adaptive), adaptive.physics, adaptive.thrust)
    old, new = (jax.tree.structure(t) for t in (adaptive.physics.table, tables.table))
    assert old == new
    assert np.all(np.isfinite(tables.table.values))
    price = tables.time_cost.running_cost(0.0, jnp.array([9.0, 9.0]))
    assert float(price) > 0


def test_time_is_cheaper_where_nothing_was_seen(adaptive):
    belief, strategy = straight_on(adaptive), ExplorationBonus()
    cost = strategy.tables(belief, adaptive.physics, adaptive.thrust).time_cost
    seen, unseen = (
        1 - float(cost.running_cost(0.0, jnp.array(x))) for x in ((1.8, 5.0), (8, 8.0))
    )
    assert unseen > 0.1
    assert abs(seen) < 0.2 * unseen


@pytest.mark.parametrize(
    ("leader", "worth", "bonus"),
    [(0, 4.0, 4.0 * 12 / 18), (3, 4.0, 4.0 * 12 / 5), (3, 9.0, None)],
)
def test_what_is_unknown_is_worth_more_where_the_force_is_smooth(
    adaptive, leader, worth, bonus
):
    """The leaders have a length scale of an 18th and of a 5th of an arena of 12."""
    belief = adaptive.believe(frame_at(1.0, 5.0))
    belief = dataclasses.replace(belief, leader=leader)
    strategy = ExplorationBonus(worth)
    cost = strategy.tables(belief, adaptive.physics, adaptive.thrust).time_cost
    x, _ = axes_of(adaptive.physics.table.grid)
    price = -0.9 if bonus is None else -bonus / (x[-1] - x[0])
    np.testing.assert_allclose(cost.risk_aversion, price, rtol=1e-6)


def test_hope_takes_half_a_deviation_off_the_mean_force(adaptive):
    """A push is observed; the hoped for force is exact by hand at each node."""
    flight = [frame_at(1.0, 5.0 + 0.02 * k**2, 0.1 * k) for k in range(1, 12)]
    belief = learned(adaptive.believe(frame_at(1.0, 5.0)), flight)
    grid, physics = adaptive.physics.table.grid, adaptive.physics.table.values
    mean, spread = mean_and_spread(belief, grid)
    tables = ExplorationBonus(hope=0.5).tables(
        belief, adaptive.physics, adaptive.thrust
    )
    added = np.asarray(tables.table.values - physics)[0, ..., :2]
    sizes = np.linalg.norm(mean, axis=-1)
    hoped = np.maximum(sizes - 0.5 * spread, 0.0)
    np.testing.assert_allclose(np.linalg.norm(added, axis=-1), hoped, atol=1e-12)
    assert np.max(hoped) > 0.05
    assert np.all(np.sum(added * mean, axis=-1) >= 0)


def test_the_oracle_believes_the_truth(adaptive):
    belief = with_truth(adaptive).believe(frame_at(1.0, 5.0))
    places = np.array([[3.0, 4.0], [6.0, 7.0]])
    force, sd = belief.force(places)
    exact = [adaptive.task.truth(0.0, jnp.asarray(x), jnp.zeros(2)) for x in places]
    np.testing.assert_allclose(force, exact, atol=2e-3)
    assert np.all(sd == 0)
    tables = ExplorationBonus().tables(belief, adaptive.physics, adaptive.thrust)
    np.testing.assert_allclose(tables.time_cost.spread.values, 0.0, atol=1e-12)
    later = belief.after(frame_at(1.1, 5.0, 0.1, thrust=(1.0, 0.0)))
    assert later.state.covariance[0, 0] < 0.03**2
    np.testing.assert_array_equal(later.force(places)[0], force)


@pytest.mark.slow
def test_sweeps_from_old_values_end_where_those_from_nothing_end(adaptive):
    tables = tabulate_model(adaptive.task, adaptive.task.truth)
    cold = adaptive.replanner.plan(tables)
    first = adaptive.replanner.plan(adaptive.physics)
    warm = adaptive.replanner.plan(tables, first.values)
    np.testing.assert_allclose(warm.values, cold.values, atol=2e-3)
    whole = time_to_go(adaptive.task, adaptive.task.truth, tables=tables, points=21)
    np.testing.assert_allclose(cold.values, whole.values, atol=2e-3)
    few = adaptive.replanner.plan(tables, first.values, sweeps=1)
    assert np.max(np.abs(few.values - warm.values)) > 1e-3


def in_a_current(adaptive, current, x=1.0, y=5.0):
    """A belief that takes a uniform current for granted."""
    grid = adaptive.physics.table.grid
    everywhere = np.zeros((*grid.shape, 2)) + np.array(current)
    force = GivenForce.of(axes_of(grid), everywhere)
    return take_for_granted(force, frame_at(x, y), motion=adaptive.motion)


def test_a_goal_out_of_reach_is_no_error_in_the_loop(adaptive):
    blown = in_a_current(adaptive, (-3.0, 0.0))
    memory = adaptive.begin(blown, jnp.zeros((1, 2)))
    assert float(memory.plan.at(jnp.array([1.0, 5.0]))) > adaptive.task.time_limit
    again = adaptive.replan(memory)
    assert np.all(np.isfinite(again.plan.values))


def safety_case(adaptive, x, heading, force=(0.0, 0.0), *, disc=True):
    """The verdict on full thrust along a heading, in a known uniform current."""
    problem = adaptive.task
    if disc:
        problem = dataclasses.replace(problem, keep_out=(Disc([6.0, 5.0], 1.0),))
    physics = tabulate_model(problem, physics_only(problem.truth))
    belief = in_a_current(adaptive, force, x)
    # The tables of a plan that knows nothing of the current: the belief counts.
    prediction = TrajectoryPrediction(
        physics.predictor, physics.control_map, problem.step, 20
    )
    state, idle = jnp.asarray(belief.state.mean), jnp.array([[0.0, heading]])
    wanted = jnp.array([physics.control_map.frequency, heading])
    verdict = check_command(
        wanted,
        Observation(jnp.asarray(0.0), state, idle),
        belief,
        prediction,
        physics,
        physics.time_cost,
        adaptive.thrust,
        2.0,
    )
    return wanted, verdict


@pytest.mark.slow
def test_a_command_into_a_disc_is_changed_and_no_other(adaptive):
    wanted, verdict = safety_case(adaptive, 1.5, 0.0, disc=False)
    np.testing.assert_array_equal(verdict.command, wanted)
    assert not verdict.changed
    assert verdict.margin > 0
    wanted, verdict = safety_case(adaptive, 4.93, 0.0)
    assert verdict.changed
    assert np.cos(float(verdict.command[1])) < 0  # away from the disc
    _, away = safety_case(adaptive, 4.93, math.pi)
    assert not away.changed
    assert wanted[1] == 0.0


def test_no_thrust_is_no_refuge_where_a_current_pushes(adaptive):
    """In a current towards the disc the way out is full thrust, not rest."""
    _, verdict = safety_case(adaptive, 4.82, 0.0, force=(0.6, 0.0))
    assert verdict.changed
    assert float(verdict.command[0]) > 0.5 * adaptive.task.limits.max_frequency


def test_a_path_to_follow_is_refused():
    with pytest.raises(InputError, match="expected a place to reach, got FollowPath"):
        AdaptiveController.of(task("follow-line"))


def test_the_window_lies_about_the_goal_and_within_the_arena(adaptive):
    grid = adaptive.window.grid
    lower = np.asarray(grid.lower)
    upper = lower + np.asarray(grid.spacing) * (np.array(grid.shape) - 1)
    goal, arena = np.asarray(adaptive.task.objective.goal), adaptive.task.arena
    assert np.all((lower < goal) & (goal < upper))
    assert np.all(lower >= arena.lower)
    assert np.all(upper <= np.asarray(arena.upper) + 1e-9)
    assert adaptive.window.cell < 0.7 * adaptive.replanner.cell


@pytest.mark.slow
def test_a_flight_that_knows_nothing_arrives_and_the_second_visit_is_quicker():
    arena = Rectangle([-1.0, -1.0], [11.0, 11.0])
    problem = vortex(objective=ReachGoal([4.0, 5.0], 0.3), delay=0.2, arena=arena)
    adaptive = AdaptiveController.of(problem, points=31)
    first, belief, moments = fly(adaptive, key=jax.random.key(1), every=1.0)
    assert first.reached
    assert not first.violated
    assert len(moments) > 2
    assert first.consistency < 3
    assert first.force_error < 0.3
    assert first.cover > 0.7
    informed = dataclasses.replace(adaptive, known=belief)
    second, _, _ = fly(informed, key=jax.random.key(2))
    oracle, _, _ = fly(with_truth(adaptive), key=jax.random.key(2))
    assert second.arrival_time < 1.2 * oracle.arrival_time
    again, _, _ = fly(adaptive, key=jax.random.key(1))
    np.testing.assert_array_equal(first.path, again.path)
    assert len(first.learn_times) == len(first.command_times) == len(first.path) - 1


def test_known_forces_and_unequal_drag_are_no_part_of_what_is_learned():
    gravity, velocity = np.array([0.0, -0.3]), np.array([0.4, -0.2])
    drag = TensorDrag(UniaxialTensor(0.5, 0.2, ConstantDirector(0.0)))
    swimmer = Swimmer(ZeroForce(), drag, ZeroForce(), ConstantForce(gravity))
    adaptive = AdaptiveController.of(vortex(swimmer), points=13, speeds=5)
    assert adaptive.motion.damping == pytest.approx(0.35)
    belief = adaptive.believe(frame_at(3.0, 5.0))
    state = np.array([3.0, 5.0, *velocity])
    filters = tuple(dataclasses.replace(f, state=state) for f in belief.filters)
    moving = dataclasses.replace(belief, filters=filters)
    seen = frame_at(3.04, 4.98, 0.1, thrust=(0.2, 0.1))
    thrust = with_known(seen, moving, adaptive.physics).thrust
    beside = gravity - (np.array([0.5, 0.2]) - 0.35) * velocity
    np.testing.assert_allclose(thrust, np.array([0.2, 0.1]) + beside, atol=1e-9)


def test_thrust_counts_by_the_mobility_without_inertia():
    push = ConstantForce([0.3, 0.0])
    swimmer = OverdampedSwimmer(ZeroForce(), ZeroForce(), 0.5, known_force=push)
    adaptive = AdaptiveController.of(vortex(swimmer), points=13)
    belief = adaptive.believe(frame_at(3.0, 5.0))
    seen = frame_at(3.0, 5.0, 0.1, thrust=(0.0, 0.8))
    frame = with_known(seen, belief, adaptive.physics)
    np.testing.assert_allclose(frame.thrust, [0.15, 0.4], atol=1e-9)
