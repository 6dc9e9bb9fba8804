"""Plans, commands and closed loops in three dimensions, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.navigation import steering_worlds
from tests.navigation.steering_worlds import drifted_time, planned, rolling, swimming

from pinav.actuation import LinearResponse, StepOutResponse
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.forces import ConstantForce, LinearDrag, Plane, SampledFlow, Tube, ZeroForce
from pinav.navigation.control.default import controller
from pinav.navigation.planning.plan import time_to_go
from pinav.navigation.predictors import ControlMap, tabulate_model
from pinav.navigation.task.steering import (
    CommandLimits,
    RollingActuator,
    all_directions,
    direction,
    direction_angles,
)
from pinav.navigation.task.task import Behind, Disc, Rectangle, Wall
from pinav.navigation.trials.closed_loop import run_many
from pinav.navigation.trials.metrics import summary

ROLLING = RollingActuator(jnp.eye(3), LinearResponse())
START, GOAL = steering_worlds.START[3], steering_worlds.GOAL[3]
TOLERANCE = steering_worlds.TOLERANCE[3]
STILL = (0.0, 0.0, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("drift", [(0.0, 0.0, 0.0), (0.4, -0.3, 0.2)])
def test_time_to_go_in_a_uniform_drift_is_that_of_the_closed_form(drift):
    """Without a drift it is the distance over the speed."""
    plan = planned(swimming(drift), points=25)
    places = jax.random.uniform(jax.random.key(1), (30, 3), minval=-1.5, maxval=1.5)
    found = np.array([plan.at(x) for x in places])
    exact = np.array([drifted_time(GOAL - x, drift, TOLERANCE) for x in places])
    # Twenty degrees between directions and cells of 0.2 make a plan a little slow.
    assert (found / exact)[exact > 1].min() > 0.99
    assert (found / exact)[exact > 1].max() < 1.09


@pytest.mark.slow
def test_coarser_grids_first_do_not_change_the_plan():
    """The values are those that sweeps from nothing end in."""
    task = swimming((0.3, 0.0, -0.2), keep_out=(Disc([0.0, 0.0, 0.0], 0.8),))
    fine, alone = planned(task, points=21), planned(task, points=14)
    assert fine.values.size > 3000 > alone.values.size
    places = jax.random.uniform(jax.random.key(2), (20, 3), minval=1.0, maxval=2.0)
    times, others = ([float(plan.at(x)) for x in places] for plan in (fine, alone))
    np.testing.assert_allclose(times, others, atol=0.2)


@pytest.mark.slow
def test_a_controller_reaches_a_goal_in_space_against_a_drift():
    drift = (-0.3, 0.2, 0.0)
    task = swimming(drift, noise=0.05, time_limit=9.0)
    keys = jax.random.split(jax.random.key(0), 2)
    episodes = run_many(task, controller(task, task.truth), keys)
    assert episodes.reached.all()
    exact = drifted_time(GOAL - START, drift, TOLERANCE)
    assert episodes.arrival_time.max() < 1.15 * exact
    outcome = summary(episodes, task)
    assert 0.8 < outcome.efficiency <= 1.0
    assert outcome.turning > 0


def test_directions_in_space_are_unit_vectors_all_around():
    ahead = all_directions(96, 3)
    np.testing.assert_allclose(np.linalg.norm(ahead, axis=1), 1.0)
    np.testing.assert_allclose(ahead.mean(axis=0), 0.0, atol=0.02)
    nearest = np.sort(ahead @ ahead.T, axis=1)[:, -2]
    assert np.degrees(np.arccos(nearest)).min() > 15
    angles = jax.vmap(direction_angles)(jnp.asarray(ahead))
    np.testing.assert_allclose(jax.vmap(direction)(angles), ahead, atol=1e-9)


def test_the_thrust_of_a_screw_is_along_the_command_in_space():
    screw = RollingActuator(0.6 * jnp.eye(3), StepOutResponse(1.0))
    thrust = screw(jnp.array([0.5, 0.7, -0.4]))
    ahead = direction(jnp.array([0.7, -0.4]))
    np.testing.assert_allclose(thrust, jnp.linalg.norm(thrust) * ahead, atol=1e-12)


def test_a_direction_turns_on_a_great_circle_and_not_faster_than_allowed():
    limits = CommandLimits(1.0, max_turning_rate=2.0)
    before, wanted = jnp.array([1.0, 0.2, 0.1]), jnp.array([1.0, 2.2, -0.6])
    soon, late = (limits.clip(wanted, before, time) for time in (0.1, 10.0))
    start, middle, end = (direction(c[1:]) for c in (before, soon, wanted))
    parts = jnp.arccos(jnp.stack([start @ middle, middle @ end]))
    np.testing.assert_allclose(parts[0], 0.2, rtol=1e-6)
    np.testing.assert_allclose(parts.sum(), jnp.arccos(start @ end), rtol=1e-6)
    np.testing.assert_allclose(direction(late[1:]), end, atol=1e-9)


def test_controls_in_space_become_commands_along_them():
    drive = ControlMap.of(ROLLING, CommandLimits(0.8), 3)
    control, before = jnp.array([0.3, -0.4, 0.2]), jnp.array([0.0, 0.5, 0.3])
    command = drive.command(control, before, 0.1)
    np.testing.assert_allclose(ROLLING(command), 0.8 * control, atol=1e-6)
    idle = drive.command(jnp.zeros(3), before, 0.1)
    np.testing.assert_allclose(idle[1:], before[1:])
    np.testing.assert_allclose(drive.thrusts(50), 0.8 * all_directions(50, 3))


def test_distances_from_a_ball_a_rod_and_a_box():
    x = jnp.array([1.0, 2.0, 2.0])
    np.testing.assert_allclose(Disc([0.0, 0.0, 0.0], 1.0).distance(x), 2.0)
    rod = Wall([1.0, 0.0, 0.0], [1.0, 0.0, 9.0], 0.5)
    np.testing.assert_allclose(rod.distance(x), 1.5)
    np.testing.assert_allclose(Rectangle([0.0] * 3, [3.0] * 3).distance(x), -1.0)


def test_what_is_behind_a_wall_or_outside_a_tube_is_forbidden():
    floor = Behind(Plane([0.0, 0.0, 2.0], 1.0), nearest=0.25)
    np.testing.assert_allclose(floor.distance(jnp.array([3.0, 1.0, 2.0])), 0.75)
    assert floor.distance(jnp.array([3.0, 1.0, 1.1])) < 0
    vessel = Behind(Tube([1.0, 0.0, 0.0], [0.0, 0.0, 0.0], 2.0), nearest=0.5)
    np.testing.assert_allclose(vessel.distance(jnp.array([9.0, 0.6, 0.8])), 0.5)
    assert vessel.distance(jnp.array([9.0, 0.0, 1.6])) < 0


def flowing(first, last, until, environment=None):
    """A swimmer in a drift that goes from one velocity to another."""
    flow = SampledFlow(jnp.array([0.0, until]), jnp.array([first, last]))
    environment = ZeroForce() if environment is None else environment
    return rolling(OverdampedSwimmer(ZeroForce(), environment, 1.0, flow), 3)


@pytest.mark.slow
def test_a_plan_in_a_drift_that_changes_is_that_of_its_mean():
    steady = swimming((0.3, 0.0, 0.0))
    truth = flowing([0.5, 0.1, 0.0], [0.1, -0.1, 0.0], steady.time_limit)
    expected = planned(steady, points=13)
    plan = planned(swimming(STILL, truth=truth), points=13)
    np.testing.assert_allclose(plan.values, expected.values, atol=2e-5)


def test_samples_in_a_flow_that_changes_differ_by_their_forces_alone():
    samples = [
        flowing([0.5, 0, 0], [0.1, 0, 0], 15.0, ConstantForce([push, 0.0, 0.0]))
        for push in (-0.3, 0.3)
    ]
    tables = tabulate_model(swimming(STILL), samples[0], samples=samples, points=5)
    assert tables.table.values.shape[0] > 1
    spread = tables.time_cost.spread
    assert spread.values.shape[0] == 1
    np.testing.assert_allclose(spread.values, np.sqrt(0.18 / 3), rtol=1e-6)


def test_inertia_and_places_in_a_wall_are_refused():
    task = swimming(STILL, start=(-1.5, -1.0, -0.5, 0.0, 0.0, 0.0))
    heavy = Swimmer(ZeroForce(), LinearDrag(1.0), ZeroForce())
    with pytest.raises(InputError, match=r"expected a swimmer without inertia in 3"):
        time_to_go(task, rolling(heavy, 3))
    with pytest.raises(InputError, match=r"goal: .* got \(1.5, 1, 0.5\) in a wall"):
        planned(swimming(STILL, keep_out=(Disc(GOAL, 0.5),)))
