"""The time-to-go against closed forms, and what a plan refuses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.navigation import steering_worlds
from tests.navigation.steering_worlds import drifted_time, planned, rolling, swimming

from pinav.dynamics import Swimmer
from pinav.errors import InputError
from pinav.forces import (
    AbstractForce,
    GaussianBarrier,
    LinearDrag,
    LinearMotion,
    Moving,
    ZeroForce,
)
from pinav.navigation.planning.plan import time_to_go
from pinav.navigation.predictors import tabulate_model
from pinav.navigation.task.task import Disc, FollowPath, LinePath, Wall

GOAL, TOLERANCE = steering_worlds.GOAL[2], steering_worlds.TOLERANCE[2]


@pytest.mark.parametrize("drift", [(0.0, 0.0), (0.4, -0.3)])
def test_time_to_go_in_a_uniform_drift_is_that_of_the_closed_form(drift):
    plan = planned(swimming(drift), points=61)
    places = jax.random.uniform(jax.random.key(1), (20, 2), minval=-2.5, maxval=2.5)
    found = np.array([plan.at(x) for x in places])
    exact = np.array([drifted_time(GOAL - x, drift, TOLERANCE) for x in places])
    assert np.abs(found - exact).max() < 0.12
    assert np.abs(found - exact).mean() < 0.06


@pytest.mark.slow
def test_time_to_go_converges_with_the_grid():
    task = swimming((0.4, -0.3))
    exact = drifted_time(GOAL - task.start, (0.4, -0.3), TOLERANCE)
    coarse, fine = (
        abs(float(planned(task, points=n).at(task.start)) - exact) for n in (21, 81)
    )
    assert fine < coarse / 2


def test_against_a_drift_that_is_faster_only_a_cone_reaches_the_goal():
    """With drift w = 2 and speed 1, headings fill a cone of half angle 30 degrees."""
    plan = planned(swimming((2.0, 0.0)), points=61)
    points = -4.0 + np.indices((61, 61)).transpose(1, 2, 0) * 8 / 60
    away = GOAL - points
    angle = np.abs(np.arctan2(away[..., 1], away[..., 0]))
    far = np.linalg.norm(away, axis=-1) > 1.5
    assert not plan.unreachable[far & (angle < np.radians(22))].any()
    assert plan.unreachable[far & (angle > np.radians(45))].all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dim", "radius", "points", "error", "depth"),
    [(2, 1.2, 61, 0.03, 0.02), (3, 0.9, 33, 0.07, 0.05)],
)
def test_the_way_around_a_ball_is_two_tangents_and_an_arc(
    dim, radius, points, error, depth
):
    """It lies half way from the start to the goal."""
    start, goal = steering_worlds.START[dim], steering_worlds.GOAL[dim]
    ball = Disc((start + goal) / 2, radius)
    task = swimming((0.0,) * dim, keep_out=(ball,))
    apart = np.linalg.norm(goal - start) / 2
    arc = radius * (np.pi - 2 * np.arccos(radius / apart))
    exact = 2 * np.sqrt(apart**2 - radius**2) + arc - steering_worlds.TOLERANCE[dim]
    plan = planned(task, points=points)
    route = plan.route(task.start)
    for time in (plan.at(task.start), route.arrival_time):
        assert float(time) == pytest.approx(exact, rel=error)
    assert float(jnp.min(jax.vmap(ball.distance)(route.ys))) > -depth


@pytest.mark.slow
def test_with_inertia_it_is_that_of_uniform_acceleration():
    """From rest, without drag: sqrt(2 d / u)."""
    truth = rolling(Swimmer(ZeroForce(), LinearDrag(0.0), ZeroForce()))
    task = swimming(truth=truth, start=(-2.0, 1.5, 0.0, 0.0))
    plan = planned(task, points=25, speeds=15)
    exact = np.sqrt(2 * (4.5 - TOLERANCE))
    assert float(plan.at(task.start)) == pytest.approx(exact, rel=0.12)
    assert float(plan.route(task.start).arrival_time) == pytest.approx(exact, rel=0.05)
    assert plan.map.shape == (25, 25)


@pytest.mark.slow
def test_a_plan_knows_how_a_force_will_change():
    """A push that comes too late is of no use; one that comes soon is."""
    push = GaussianBarrier(-40.0, [30.0, 1.5], 20.0)  # towards +x in the whole arena
    leaving, start = Moving(push, LinearMotion([4.0, 0.0])), jnp.array([-3.0, 1.5])
    steady, fading, alone = (
        planned(swimming(start=start, environment=force), points=31)
        for force in (push, leaving, None)
    )
    times = [float(plan.at(start)) for plan in (steady, fading, alone)]
    assert times[0] < times[1] - 0.2 < times[2] - 0.4
    assert float(fading.at(start, 15.0)) > times[1] + 0.2


def test_what_has_no_plan_is_refused():
    class Broken(AbstractForce):
        def __call__(self, t, x, v):
            return x / jnp.where(x[0] > 1, 0.0, 1.0)

    wall, disc = Wall([-2.0, -3.0], [-2.0, 1.0], 0.2), Disc([2.5, 1.5], 0.5)
    path = FollowPath(LinePath([0.0, 0.0], [1.0, 1.0], 5.0))
    for changes, message in (
        ({"keep_out": (wall,)}, r"start: expected a free place, got \(-2"),
        ({"keep_out": (disc,)}, r"goal: expected a free place, got \(2.5"),
        ({"start": (-9.0, 0.0)}, "start: expected a place in the arena"),
        ({"environment": Broken()}, "model: expected a finite force"),
        ({"objective": path}, "task 'open water': expected a place to"),
    ):
        with pytest.raises(InputError, match=message):
            planned(swimming(**changes))


@pytest.mark.slow
def test_a_goal_behind_walls_or_up_a_drift_is_refused():
    closed = Wall([0.0, -5.0], [0.0, 5.0], 0.15)
    for task in (swimming(keep_out=(closed,)), swimming((-1.5, 0.0))):
        with pytest.raises(InputError, match=r"goal: expected a place that can be"):
            planned(task)


@pytest.mark.slow
def test_unknown_ground_is_gone_around():
    """Two samples that disagree in a disc: time costs more there."""
    task, hills = (
        swimming(),
        [GaussianBarrier(h, [0.25, 0.25], 0.6) for h in (-1.0, 1.0)],
    )
    samples = [swimming(environment=hill).truth for hill in hills]
    tables = tabulate_model(task, task.truth, samples=samples, margin=0.01, points=41)
    wary = time_to_go(task, task.truth, tables=tables)
    ways = [plan.route(task.start).ys for plan in (planned(task), wary)]
    near = [float(jnp.min(jnp.linalg.norm(y - 0.25, axis=1))) for y in ways]
    assert near[0] < 0.2 < 0.6 < near[1]
