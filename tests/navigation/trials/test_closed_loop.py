"""Closed loops against closed forms: delay, noise, arrival, violation, pairs."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.navigation.steering_worlds import (
    AHEAD,
    ASIDE,
    DRAG,
    Held,
    Recited,
    open_water,
)

from pinav.dynamics import rollout
from pinav.forces import CircularMotion, GaussianBarrier, Moving
from pinav.navigation.task.steering import CommandLimits
from pinav.navigation.task.task import Disc, ReachGoal, Rectangle
from pinav.navigation.trials import closed_loop
from pinav.navigation.trials.closed_loop import run, run_many
from pinav.navigation.trials.situation import PARTS

KEY = jax.random.key(3)
KEYS = jax.random.split(KEY, 600)
DELAYS = [
    0.25,
    *(pytest.param(delay, marks=pytest.mark.slow) for delay in (0.0, 0.04, 0.3)),
]


def delayed_way(commands, delay, *, step, steps):
    """Integral of n(heading) f(t - delay) where nothing is commanded before t = 0."""
    edges = step * np.arange(len(commands) + 1) + delay
    spans = np.diff(np.minimum(edges, step * steps))
    return spans @ (commands[:, :1] * directions(commands[:, 1]))


def directions(headings):
    return np.stack([np.cos(headings), np.sin(headings)], axis=1)


@pytest.mark.parametrize("delay", DELAYS)
def test_a_command_comes_into_force_after_the_delay_exactly(delay):
    rng = np.random.default_rng(0)
    commands = np.stack([rng.uniform(0, 1, 20), rng.uniform(-3, 3, 20)], axis=1)
    task = open_water(delay=delay)
    episode = run(task, Recited(jnp.asarray(commands)), key=KEY)
    expected = delayed_way(commands, delay, step=0.1, steps=20)
    np.testing.assert_allclose(episode.states[-1], expected, atol=1e-12)
    np.testing.assert_allclose(
        directions(episode.commands[:, 1]), directions(commands[:, 1]), atol=1e-12
    )


@pytest.mark.parametrize("delay", DELAYS)
def test_pending_commands_are_those_not_in_force_and_the_oldest_is(delay):
    task = open_water(delay=delay)
    now, given = closed_loop.begin(task), []
    for index in range(6):
        command = jnp.array([0.1 * (index + 1), 0.0])
        pending = closed_loop.observe(task, now, KEY).pending[:, 0]
        count = max(1, math.ceil(delay / 0.1 - 1e-9))
        expected = [*[0.0] * count, *given][-count:]
        np.testing.assert_allclose(pending, expected, atol=1e-12)
        now, _ = closed_loop.advance(task, task.truth, now, command, KEY)
        given.append(0.1 * (index + 1))


@pytest.mark.slow
def test_the_truth_moves_as_its_equation_says():
    """Against diffrax at 1e-11, with a force that moves."""
    motion = CircularMotion(radius=0.5, frequency=1.0)
    moving = Moving(GaussianBarrier(0.5, [1.0, 0.3], 0.6), motion)
    task = open_water(inert=True, environment=moving)
    episode = run(task, AHEAD, key=KEY)
    held = task.truth.under(AHEAD.command)
    expected = rollout(held, task.start, episode.ts).ys
    np.testing.assert_allclose(episode.states, expected, atol=1e-7)


@pytest.mark.slow
def test_white_noise_has_the_strength_that_was_asked_for():
    """Diffusion without inertia; Ornstein and Uhlenbeck's variance with it."""
    carried = run_many(open_water(noise=0.3), AHEAD, KEYS).states[:, -1]
    spread = 5 / math.sqrt(2 * 2 * len(KEYS))
    np.testing.assert_allclose(np.std(carried - [2.0, 0.0]) / 0.3, 2**0.5, rtol=spread)
    inert = run_many(open_water(noise=0.3, inert=True), AHEAD, KEYS).states[:, -1, 2:]
    settled = (1 - math.exp(-DRAG * 2)) / DRAG
    variance = 0.3**2 * (1 - math.exp(-2 * DRAG * 2)) / (2 * DRAG)
    error = inert - np.array([settled, 0.0])
    np.testing.assert_allclose(np.std(error), variance**0.5, rtol=spread)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["cpu", "gpu"])
def test_many_are_the_same_as_one_by_one_and_end_by_themselves(backend, monkeypatch):
    """On an accelerator, episodes run side by side, with the same result."""
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    task = open_water(
        noise=0.4, sensor_noise=0.1, delay=0.15, objective=ReachGoal([1.0, 0.0], 0.4)
    )
    many = run_many(task, AHEAD, KEYS[:9])
    assert 0 < many.reached.sum() < 9
    for index in range(3):
        one = run(task, AHEAD, key=KEYS[index])
        assert one.steps == many.steps[index] == len(one.compute)
        assert one.reached == many.reached[index]
        np.testing.assert_allclose(one.arrival_time, many.arrival_time[index])
        np.testing.assert_allclose(one.clearance, many.clearance[index], rtol=1e-12)
        own = many.states[index, : one.steps + 1]
        np.testing.assert_allclose(one.states, own, atol=1e-12)
        np.testing.assert_array_equal(many.states[index, one.steps :] - own[-1], 0)


@pytest.mark.slow
def test_noise_belongs_to_its_key_whatever_the_controller():
    """Episodes of two controllers with the same keys are pairs."""
    task = open_water(noise=0.4)
    ahead, aside = (run_many(task, c, KEYS[:5]).states for c in (AHEAD, ASIDE))
    apart = np.arange(21) * 0.1
    expected = np.broadcast_to(np.stack([apart, -apart], axis=1), ahead.shape)
    np.testing.assert_allclose(ahead - aside, expected, atol=1e-12)


def test_arrival_is_told_to_within_a_step_and_a_lost_state_is_a_violation():
    task = open_water(objective=ReachGoal([1.0, 0.0], 0.3141))
    episode = run(task, AHEAD, key=KEY)
    assert episode.reached
    np.testing.assert_allclose(episode.arrival_time, 1 - 0.3141, atol=1e-12)
    lost = run(task, Held(jnp.array([1.0, jnp.nan])), key=KEY)
    assert (lost.violated, lost.steps) == (True, 1)


@pytest.mark.parametrize(
    "changes",
    [
        {"keep_out": (Disc([1.0, 0.0], 0.25),)},
        {"arena": Rectangle([-1.0, -1.0], [0.75, 1.0])},
    ],
    ids=["zone", "arena"],
)
def test_a_violation_ends_the_episode(changes):
    task = open_water(objective=ReachGoal([1.6, 0.0], 0.3), **changes)
    episode = run(task, AHEAD, key=KEY)
    assert (episode.violated, episode.reached, episode.steps) == (True, False, 8)
    assert episode.arrival_time == math.inf
    longest = task.step / PARTS  # at speed one
    assert -longest - 1e-9 <= episode.clearance < 0


def test_the_heading_turns_no_faster_than_coils_do():
    task = open_water(limits=CommandLimits(0.7, max_turning_rate=2.0))
    episode = run(task, ASIDE, key=KEY)
    expected = np.minimum(0.2 * np.arange(1, 21), math.pi / 2)
    np.testing.assert_allclose(episode.commands[:, 1], expected, atol=1e-12)
    np.testing.assert_allclose(episode.commands[:, 0], 0.7)


@pytest.mark.slow
def test_another_truth_takes_the_place_of_that_of_the_task():
    task = open_water()
    slow = eqx.tree_at(lambda s: s.actuator.gain, task.truth, 0.5 * jnp.eye(2))
    episode = run_many(task, AHEAD, KEYS[:1], truth=slow)
    np.testing.assert_allclose(episode.states[0, -1], [1.0, 0.0], atol=1e-12)


@pytest.mark.slow
def test_sensor_noise_is_in_what_is_seen_and_not_in_what_is():
    task = dataclasses.replace(open_water(), sensor_noise=0.2)
    now = closed_loop.begin(task)
    seen = jax.vmap(lambda key: closed_loop.observe(task, now, key).state)(KEYS)
    np.testing.assert_allclose(np.std(seen), 0.2, rtol=5 / math.sqrt(4 * len(KEYS)))
    np.testing.assert_allclose(run(task, AHEAD, key=KEY).states[-1], [2.0, 0.0])
