"""Delay compensation is exact without noise; the filter is as good as it says."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest
from tests.navigation.steering_worlds import SwimmerPredictor, open_water, rolling

from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.forces import GaussianBarrier, LinearDrag, ZeroForce
from pinav.navigation.control.controller import AbstractController
from pinav.navigation.control.default import (
    StateEstimation,
    predict_onset,
)
from pinav.navigation.trials.situation import advance, begin, observe

pytestmark = pytest.mark.slow

BARRIER = GaussianBarrier(2.0, [1.0, 1.0], 1.0)
MODELS = {
    "inertial": rolling(Swimmer(ZeroForce(), LinearDrag(0.4), BARRIER)),
    "overdamped": rolling(OverdampedSwimmer(ZeroForce(), BARRIER, 1.0)),
}


class Wanderer(AbstractController):
    """Random commands; remembers what it was told last."""

    size: int = eqx.field(static=True)

    def start(self, observation):
        return observation.time, observation.state

    def __call__(self, observation, memory, *, key):
        frequency, heading = jax.random.uniform(key, (2,))
        command = jnp.stack([frequency, 6 * heading])
        return command, (observation.time, observation.state)


def task_of(truth, **changes):
    size = 4 if isinstance(truth.dynamics, Swimmer) else 2
    start = jnp.array([0.2, -0.3, 0.1, 0.2])[:size]
    return open_water(truth=truth, start=start, **changes)


@pytest.mark.parametrize("delay", [0.07, 0.2, 0.25])
@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_the_predicted_state_is_that_in_which_the_command_comes_into_force(
    model, delay
):
    """From there the command leads to the true state at the next control step."""
    task = task_of(model, delay=delay)
    predictor, key = SwimmerPredictor(model), jax.random.key(3)
    predict = eqx.filter_jit(lambda seen: predict_onset(predictor, task.timing, seen))
    move = eqx.filter_jit(lambda now, c: advance(task, model, now, c, key))
    now, ahead, commands, states = begin(task), [], [], []
    for step in range(8):
        seen = observe(task, now, key)
        command, _ = Wanderer(4)(seen, None, key=jax.random.fold_in(key, step))
        ahead.append(predict(seen))
        commands.append(command)
        states.append(now.state)
        now, _ = move(now, command)
    whole = math.ceil(delay / task.step - 1e-9)
    for one, command, later in zip(ahead, commands, states[whole:], strict=False):
        held = whole * task.step - delay
        reached = SwimmerPredictor(model).step(one.time, one.state, command, held)
        assert jnp.allclose(reached, later, atol=2e-5)


@pytest.mark.parametrize("delay", [0.0, 0.25])
@pytest.mark.parametrize("truth", MODELS.values(), ids=MODELS)
def test_the_state_is_as_far_off_as_the_filter_says(truth, delay):
    noises = {"noise": 0.05, "sensor_noise": 0.02}
    task = task_of(truth, delay=delay, **noises)
    controller = StateEstimation(
        Wanderer(2), SwimmerPredictor(truth), task.timing, **noises
    )

    def step(carry, key):
        now, memory = carry
        sensing, deciding, moving = jax.random.split(key, 3)
        command, memory = controller(observe(task, now, sensing), memory, key=deciding)
        later, _ = advance(task, truth, now, command, moving)
        error = memory.mean - now.state
        surprise = error @ jnp.linalg.solve(memory.covariance, error)
        return (later, memory), (surprise, error)

    start = begin(task)
    memory = controller.start(observe(task, start, jax.random.key(1)))
    begun = start, jax.tree.map(jnp.asarray, memory)
    keys = jax.random.split(jax.random.key(2), 150)
    surprises, errors = eqx.filter_jit(jax.lax.scan)(step, begun, keys)[1]
    assert abs(jnp.mean(surprises) / errors.shape[1] - 1) < 0.35
    assert jnp.std(errors[:, :2]) < 0.018  # better than the sensor
