"""Gymnasium's own checker, and the same world as the closed loop."""

import math
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.navigation.steering_worlds import AHEAD, open_water

from pinav.errors import InputError
from pinav.navigation.task import catalogue as tasks
from pinav.navigation.task.task import Disc, FollowPath, LinePath, ReachGoal
from pinav.navigation.trials.closed_loop import run

gymnasium = pytest.importorskip(
    "gymnasium", reason="gymnasium is not installed; pip install 'pinav[gym]'"
)
FULL_AHEAD = np.array([1.0, 0.0], np.float32)


def environment(task):
    from examples.gymnasium_environment import NavigationEnv

    return NavigationEnv(task)


@pytest.mark.parametrize("name", ["barrier-strong", "follow-circle"])
def test_gymnasium_finds_nothing_wrong(name):
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings():  # it asks for a registered name, and for pictures
        warnings.filterwarnings("ignore", message=".*(spec|render).*")
        check_env(environment(tasks.task(name)), skip_render_check=True)


def test_an_agent_meets_the_same_world_as_a_controller():
    task = open_water(delay=0.25, objective=ReachGoal([1.0, 0.0], 0.3))
    world = environment(task)
    first, info = world.reset(seed=1)
    np.testing.assert_allclose(first[:5], [0.0, 0.0, 1.0, 0.0, 2.0])
    assert info["time"] == 0.0
    rewards, ended, states = [], False, [first[:2]]
    while not ended:
        seen, reward, ended, truncated, info = world.step(FULL_AHEAD)
        assert not truncated
        rewards.append(reward)
        states.append(seen[:2])
    episode = run(task, AHEAD, key=jax.random.key(0))
    np.testing.assert_allclose(states, episode.states, atol=1e-6)
    np.testing.assert_allclose(info["arrival_time"], episode.arrival_time, rtol=1e-6)
    way = float(np.linalg.norm(episode.states[-1] - [1.0, 0.0]))
    np.testing.assert_allclose(sum(rewards), 1.0 - way - 0.1 * episode.steps, rtol=1e-6)


def test_a_violation_costs_the_time_that_was_left():
    world = environment(open_water(keep_out=(Disc([0.5, 0.0], 0.35),)))
    world.reset(seed=0)
    world.step(FULL_AHEAD)
    _, reward, ended, truncated, info = world.step(FULL_AHEAD)
    assert (ended, truncated, info["violated"]) == (True, False, True)
    moved = 0.15 + 0.025  # it stops where it enters
    np.testing.assert_allclose(reward, moved - 0.1 - 0.1 - 1.8, atol=0.03)


def test_time_runs_out_and_paths_reward_nearness():
    path = FollowPath(LinePath([0.0, 1.0], [1.0, 1.0], 1.0))
    world = environment(open_water(objective=path, time_limit=0.2))
    world.reset(seed=0)
    _, reward, *ends, _ = world.step(FULL_AHEAD)
    np.testing.assert_allclose(reward, -0.1, rtol=1e-6)
    assert ends == [False, False]
    assert world.step(FULL_AHEAD)[2:4] == (False, True)


def test_a_seed_is_the_same_again_and_actions_are_clipped():
    world = environment(tasks.task("y-junction"))
    runs = []
    for action in (FULL_AHEAD, FULL_AHEAD, np.array([7.0, 0.0])):
        world.reset(seed=4)
        runs.append(world.step(action)[0])
    np.testing.assert_array_equal(runs[0], runs[1])
    np.testing.assert_array_equal(runs[0], runs[2])
    world.reset(seed=5)
    assert not np.array_equal(world.step(FULL_AHEAD)[0], runs[0])


@pytest.mark.parametrize("action", [np.zeros(3), [math.nan, 0.0]])
def test_an_action_is_two_numbers(action):
    world = environment(open_water())
    with pytest.raises(InputError, match=r"no episode has begun; call reset\(\)"):
        world.step(FULL_AHEAD)
    world.reset(seed=0)
    with pytest.raises(InputError, match="step: expected two finite numbers, got "):
        world.step(action)


def test_actions_cover_all_headings_and_frequencies():
    from examples.gymnasium_environment import _command

    task = tasks.task("vortex")
    low, high = (_command(task, a) for a in ([-1.0, -1.0], [1.0, 1.0]))
    np.testing.assert_allclose(low, [0.0, -math.pi])
    np.testing.assert_allclose(high, jnp.array([task.limits.max_frequency, math.pi]))
