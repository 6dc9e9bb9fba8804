"""Path integral control and shooting against optima that are known."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.navigation import steering_worlds
from tests.navigation.steering_worlds import SwimmerPredictor, drifted_time, swimming
from tests.refusals import refusals

from pinav.navigation.control.controller import (
    Observation,
    TrackingCost,
    TrajectoryPrediction,
)
from pinav.navigation.control.default import controller
from pinav.navigation.control.mppi import GradientMPC, PathIntegral
from pinav.navigation.predictors import tabulate_model
from pinav.navigation.task.task import CirclePath, Disc, FollowPath, ReachGoal
from pinav.navigation.trials.closed_loop import run, run_many

START, GOAL = steering_worlds.START[2], steering_worlds.GOAL[2]


@functools.cache
def tables():
    return tabulate_model(swimming(), swimming().truth, points=21)


def course(steps=20):
    return TrajectoryPrediction(tables().predictor, tables().control_map, 0.1, steps)


def aim():
    return course(), TrackingCost(swimming().objective, tables().time_cost)


METHODS = {
    "path integral": lambda prediction, cost: PathIntegral(
        prediction, cost, samples=256, rounds=6
    ),
    "shooting": lambda prediction, cost: GradientMPC(prediction, cost, iterations=150),
}


@pytest.mark.parametrize("make", METHODS.values(), ids=METHODS)
def test_both_methods_find_the_optimum_of_a_quadratic_cost(make):
    """Cost and model are linear and quadratic: the optimum is by least squares."""
    steps, effort, h = 6, 0.05, 0.1
    cost = TrackingCost(
        ReachGoal(np.array([-1.8, -0.9]), 0.1), tables().time_cost, effort
    )
    method = make(
        TrajectoryPrediction(tables().predictor, tables().control_map, h, steps), cost
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
def test_a_course_is_that_of_the_model():
    truth = swimming((0.4, -0.3)).truth
    ahead = TrajectoryPrediction(SwimmerPredictor(truth), tables().control_map, 0.1, 5)
    seen = Observation(jnp.zeros(()), jnp.asarray(START), jnp.zeros((1, 2)))
    ts, ys = ahead(seen, 0.6 * jnp.tile(jnp.array([[0.6, 0.8]]), (5, 1)))
    velocity = jnp.array([0.36 + 0.4, 0.48 - 0.3])
    assert jnp.allclose(ys, START[None] + ts[:, None] * velocity[None], atol=1e-6)


test_settings_that_make_no_sense_are_refused = refusals(
    (lambda: PathIntegral(*aim(), samples=1), "samples: expected >= 2, got 1"),
    (lambda: PathIntegral(*aim(), rounds=0), "rounds: expected >= 1, got 0"),
    (lambda: PathIntegral(*aim(), spread=0.0), "spread: expected > 0, got 0.0"),
    (
        lambda: PathIntegral(*aim(), temperature=-1.0),
        "temperature: expected > 0, got -1",
    ),
    (lambda: GradientMPC(*aim(), iterations=0), "iterations: expected > 0, got 0"),
    (lambda: GradientMPC(*aim(), rate=0.0), "rate: expected > 0, got 0.0"),
    (lambda: course(0), "TrajectoryPrediction.steps: expected >= 1, got 0"),
)
