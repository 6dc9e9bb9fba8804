"""The tasks as Gymnasium environments; needs the extra `gym`.

The same true swimmer, noise, sensor and delay as in
`pinav.navigation.trials.closed_loop`: what an agent gets here is what a controller
gets there. Copy this file; run it to see an agent that drives straight ahead.
"""

import math
from typing import Any

import equinox as eqx
import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.spaces import Box
from jaxtyping import Array, Float, Float32, PRNGKeyArray

from pinav.errors import InputError
from pinav.navigation.task.catalogue import task
from pinav.navigation.task.steering import Command, SteeredSwimmer
from pinav.navigation.task.task import Task
from pinav.navigation.trials.situation import (
    Situation,
    advance,
    begin,
    control_steps,
    observe,
)

FAR = 1e6
"""Bound of what is observed; nothing comes near it."""


class NavigationEnv(gymnasium.Env):
    r"""A navigation task for agents.

    An action in [-1, 1]² is frequency and heading: $f = f_{max} (a_0 + 1) / 2$ and
    $\theta = \pi a_1$. An observation is the state, the way to the target, the time
    left, and the pending commands as (f cos, f sin); it has the error of the sensor.

    The reward of a step is what the way to the target became shorter [L], less the time
    that it took, so that the quickest way has the greatest sum; for a path it is minus
    the mean distance from the target times the time. A violation costs the time that
    was left.

    Attributes:
        task: what is to be done.
        truth: the true swimmer.

    Raises:
        InputError: the action is not a pair of numbers, or `step` comes before `reset`.
    """

    def __init__(self, task: Task, *, truth: SteeredSwimmer | None = None) -> None:
        self.task = task
        self.truth = task.truth if truth is None else truth
        self.action_space = Box(-1.0, 1.0, (2,), np.float32)
        self._situation: Situation | None = None
        self._key: PRNGKeyArray | None = None
        first = begin(task)
        size = first.state.size + 3 + first.pending.size
        self.observation_space = Box(-FAR, FAR, (size,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float32[np.ndarray, " observation"], dict[str, float | bool]]:
        """Begin an episode; a seed makes it the same again."""
        gymnasium.Env.reset(self, seed=seed, options=options)
        self._key = jax.random.key(int(self.np_random.integers(2**31)))
        self._situation = begin(self.task)
        return self._observation(self._situation), self._info(self._situation)

    def step(
        self, action: Any
    ) -> tuple[
        Float32[np.ndarray, " observation"], float, bool, bool, dict[str, float | bool]
    ]:
        """One control step: observation, reward, whether it ended or time is up."""
        before, key = self._situation, self._key
        if before is None or key is None:
            raise InputError("NavigationEnv.step: no episode has begun; call reset()")
        command = _command(self.task, action)
        moving = jax.random.split(jax.random.fold_in(key, before.step), 3)[2]
        now, _ = _advance(self.task, self.truth, before, command, moving)
        self._situation = now
        ended = bool(now.reached | now.violated)
        truncated = not ended and int(now.step) >= control_steps(self.task)
        reward = float(_reward(self.task, before, now))
        return self._observation(now), reward, ended, truncated, self._info(now)

    def _observation(self, situation: Situation) -> Float32[np.ndarray, " observation"]:
        if self._key is None:
            raise InputError("NavigationEnv: no episode has begun; call reset()")
        sensing = jax.random.split(jax.random.fold_in(self._key, situation.step), 3)[0]
        return np.array(_features(self.task, situation, sensing), np.float32)

    def _info(self, situation: Situation) -> dict[str, float | bool]:
        return {
            "time": self.task.step * int(situation.step),
            "reached": bool(situation.reached),
            "violated": bool(situation.violated),
            "arrival_time": float(situation.arrival_time),
            "clearance": float(situation.clearance),
        }


def _command(task: Task, action: Any) -> Command:
    values = np.asarray(action, float)
    if values.shape != (2,) or not np.isfinite(values).all():
        raise InputError(
            f"NavigationEnv.step: expected two finite numbers, got {action}"
        )
    speed, turn = np.clip(values, -1.0, 1.0)
    return jnp.array([task.limits.max_frequency * (speed + 1) / 2, math.pi * turn])


_advance = eqx.filter_jit(advance)


@eqx.filter_jit
def _features(
    task: Task, situation: Situation, key: PRNGKeyArray
) -> Float[Array, " observation"]:
    observation = observe(task, situation, key)
    way = task.objective.target(observation.time) - observation.state[:2]
    left = jnp.asarray(task.time_limit - observation.time)
    frequencies, headings = observation.pending.T
    pending = frequencies[None] * jnp.stack([jnp.cos(headings), jnp.sin(headings)])
    return jnp.concatenate([observation.state, way, left[None], pending.ravel()])


@eqx.filter_jit
def _reward(task: Task, before: Situation, now: Situation) -> Float[Array, ""]:
    ways = [_distance_to_target(task, situation) for situation in (before, now)]
    left = task.time_limit - _time(task, now)
    penalty = jnp.where(now.violated, left, 0.0)
    ends = jnp.isfinite(task.objective.distance(now.state[:2]))
    reached = ways[0] - ways[1] - task.step
    followed = -task.step * (ways[0] + ways[1]) / 2
    return jnp.where(ends, reached, followed) - penalty


def _distance_to_target(task: Task, situation: Situation) -> Float[Array, ""]:
    target = task.objective.target(_time(task, situation))
    return jnp.linalg.norm(target - situation.state[:2])


def _time(task: Task, situation: Situation) -> Float[Array, ""]:
    return task.step * situation.step.astype(situation.state.dtype)


def main() -> None:
    """Drive straight ahead on a task, and print what it was worth."""
    env, total, over = NavigationEnv(task("barrier-strong")), 0.0, False
    env.reset(seed=0)
    while not over:
        _, reward, ended, truncated, info = env.step([1.0, 0.25])
        total, over = total + reward, ended or truncated
    print(f"reward {total:.2f} after {info['time']:.1f}, reached: {info['reached']}")


if __name__ == "__main__":
    main()
