"""Path integral control and shooting against optima that are known."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.navigation import steering_worlds
from tests.navigation.steering_worlds import SwimmerPredictor, drifted_time, swimming

from pinav.errors import InputError
from pinav.navigation.control.controller import (
    ArrivalCost,
    GradientGuide,
    Observation,
    TrackingCost,
    TrajectoryPrediction,
)
from pinav.navigation.control.default import controller
from pinav.navigation.control.mppi import GradientMPC, PathIntegral
from pinav.navigation.planning.plan import time_to_go
from pinav.navigation.predictors import tabulate_model
from pinav.navigation.task.task import (
    CirclePath,
    Disc,
    FollowPath,
    ReachGoal,
)
from pinav.navigation.trials.closed_loop import run, run_many

START, GOAL = steering_worlds.START[2], steering_worlds.GOAL[2]


@pytest.fixture(scope="module")
def tables():
    return tabulate_model(swimming(), swimming().truth, points=21)


METHODS = {
    "path integral": lambda prediction, cost: PathIntegral(
        prediction, cost, samples=256, rounds=6
    ),
    "shooting": lambda prediction, cost: GradientMPC(prediction, cost, iterations=150),
}


@pytest.mark.parametrize("make", METHODS.values(), ids=METHODS)
def test_both_methods_find_the_optimum_of_a_quadratic_cost(tables, make):
    """Cost and model are linear and quadratic: the optimum is by least squares."""
    steps, effort, h = 6, 0.05, 0.1
    cost = TrackingCost(
        ReachGoal(np.array([-1.8, -0.9]), 0.1), tables.time_cost, effort
    )
    method = make(
        TrajectoryPrediction(tables.predictor, tables.control_map, h, steps), cost
    )
    seen = Observation(jnp.zeros(()), jnp.asarray(START), jnp.zeros((1, 2)))
    decide = eqx.filter_jit(lambda memory, key: method(seen, memory, key=key)[1])
    controls = method.start(seen)
    for key in jax.random.split(jax.random.key(0), 4):
        controls = jnp.concatenate([controls[:1], controls[:-1]])  # undo the warm start
        controls = decide(controls, key)
    positions = np.sqrt(h) * h * np.tril(np.ones((steps, steps)))
    changes = np.sqrt(effort) * np.diff(np.eye(steps), axis=0)
    wanted = np.sqrt(h) * np.tile([[0.2, 0.1]], (steps, 1))
    rows = np.vstack([positions, changes])
    wanted = np.vstack([wanted, np.zeros((steps - 1, 2))])
    best = np.linalg.lstsq(rows, wanted, rcond=None)[0]
    assert np.linalg.norm(best, axis=1).max() < 1  # so that no bound is active
    found = cost(*method.prediction(seen, controls), controls)
    least = cost(*method.prediction(seen, jnp.asarray(best)), jnp.asarray(best))
    nothing = 0.05 * h * steps  # the cost of standing still
    assert float(found - least) < 0.02 * (nothing - float(least))


@pytest.mark.slow
def test_arrival_in_a_uniform_drift_is_that_of_the_closed_form():
    task = swimming((0.4, -0.3))
    exact = drifted_time(GOAL - START, (0.4, -0.3), 0.2)
    episode = run(task, controller(task, task.truth), key=jax.random.key(0))
    assert episode.reached
    assert episode.arrival_time == pytest.approx(exact, rel=0.01)


@pytest.mark.slow
def test_shooting_arrives_as_soon_as_path_integrals(tables):
    task = swimming((0.2, 0.0))
    here = tabulate_model(task, task.truth, points=21)
    plan = time_to_go(task, task.truth, tables=here, points=41)
    prediction = TrajectoryPrediction(here.predictor, here.control_map, task.step, 12)
    cost, guide = ArrivalCost(plan), GradientGuide(plan)
    times = [
        run(task, method, key=jax.random.key(0)).arrival_time
        for method in (
            GradientMPC(prediction, cost, guide, iterations=10),
            PathIntegral(prediction, cost, guide),
        )
    ]
    assert times[0] == pytest.approx(times[1], rel=0.02)


@pytest.mark.slow
def test_a_zone_is_never_entered_when_the_model_is_true():
    disc = Disc([0.25, 0.25], 1.0)
    task = swimming(keep_out=(disc,), noise=0.05)
    keys = jax.random.split(jax.random.key(1), 20)
    episodes = run_many(task, controller(task, task.truth), keys)
    assert episodes.reached.all()
    assert episodes.clearance.min() > 0


@pytest.mark.slow
def test_a_path_is_followed_through_a_delay():
    """Only the first moments, before the first command, are lost."""
    circle = CirclePath(center=[-2.0, 0.0], radius=1.0, period=12.0, phase=-np.pi / 2)
    task = swimming((0.3, 0.1), objective=FollowPath(circle), delay=0.2, time_limit=6.0)
    episode = run(task, controller(task, task.truth), key=jax.random.key(0))
    targets = jax.vmap(task.objective.target)(jnp.asarray(episode.ts))
    errors = np.linalg.norm(episode.states - np.asarray(targets), axis=1)
    assert errors[20:].max() < 0.02


@pytest.mark.slow
def test_a_course_is_that_of_the_model(tables):
    task = swimming((0.4, -0.3))
    prediction = TrajectoryPrediction(
        SwimmerPredictor(task.truth), tables.control_map, 0.1, 5
    )
    seen = Observation(jnp.zeros(()), jnp.asarray(START), jnp.zeros((1, 2)))
    controls = 0.6 * jnp.tile(jnp.array([[0.6, 0.8]]), (5, 1))
    ts, ys = prediction(seen, controls)
    velocity = jnp.array([0.36 + 0.4, 0.48 - 0.3])
    assert jnp.allclose(ys, START[None] + ts[:, None] * velocity[None], atol=1e-6)


BAD = {
    "samples": (lambda c, j: PathIntegral(c, j, samples=1), ">= 2, got 1"),
    "rounds": (lambda c, j: PathIntegral(c, j, rounds=0), ">= 1, got 0"),
    "spread": (lambda c, j: PathIntegral(c, j, spread=0.0), "> 0, got 0.0"),
    "temperature": (lambda c, j: PathIntegral(c, j, temperature=-1.0), "> 0, got -1.0"),
    "iterations": (lambda c, j: GradientMPC(c, j, iterations=0), "> 0, got 0"),
    "rate": (lambda c, j: GradientMPC(c, j, rate=0.0), "> 0, got 0.0"),
}


@pytest.mark.parametrize(("name", "make", "message"), [(k, *v) for k, v in BAD.items()])
def test_settings_that_make_no_sense_are_refused(tables, name, make, message):
    prediction = TrajectoryPrediction(tables.predictor, tables.control_map, 0.1)
    cost = TrackingCost(swimming().objective, tables.time_cost)
    with pytest.raises(InputError, match=rf"{name}: expected {message}"):
        make(prediction, cost)


def test_a_course_has_steps(tables):
    with pytest.raises(
        InputError, match=r"TrajectoryPrediction.steps: expected >= 1, got 0"
    ):
        TrajectoryPrediction(tables.predictor, tables.control_map, 0.1, 0)
