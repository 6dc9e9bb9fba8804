"""A controller steers the true swimmer: one episode, or many at once.

At every control step the controller observes the state, with the error of the sensor,
and gives a command; see `pinav.navigation.trials.situation` for what becomes of it.
"""

import dataclasses
import operator
import time
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Generic

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int, PRNGKeyArray, PyTree, Shaped

from pinav.navigation.control.controller import AbstractController, Memory, Observation
from pinav.navigation.task.steering import Command, SteeredSwimmer
from pinav.navigation.task.task import Task
from pinav.navigation.trials.situation import (
    Situation,
    advance,
    advance_compiled,
    begin,
    control_steps,
    observe,
    observe_compiled,
)

_Carry = tuple[
    Situation, PyTree, Float[Array, "time state"], Float[Array, "control dim"]
]
"""Situation, memory of the controller, states and commands of an episode so far."""


class Episodes(eqx.Module):
    """The course of one run, or of many: then runs are the first axis of all but ts.

    After the end of a run its last state stays.

    Attributes:
        commands: what was commanded from each of them on, within the limits.
        steps: control steps until it ended.
        reached: whether the task was done, without a violation before.
        violated: whether it ended in a forbidden place.
        arrival_time: when the task was done [T]; else infinite.
        clearance: least distance from forbidden places [L].
        compute: time that each command of a single run took to compute [s]; the first
            one includes the compilation, unless the controller was compiled before.
            Empty for many runs.
    """

    ts: Float[np.ndarray, " time"]
    states: Float[np.ndarray, "*run time state"]
    commands: Float[np.ndarray, "*run control dim"]
    steps: Int[np.ndarray, "*run"]
    reached: Bool[np.ndarray, "*run"]
    violated: Bool[np.ndarray, "*run"]
    arrival_time: Float[np.ndarray, "*run"]
    clearance: Float[np.ndarray, "*run"]
    compute: Float[np.ndarray, " timed"]

    @classmethod
    def of(
        cls,
        task: Task,
        last: Situation,
        states: ArrayLike,
        commands: ArrayLike,
        compute: Sequence[float] = (),
    ) -> "Episodes":
        """Runs by their last situations and what led there."""
        paths = np.asarray(states, float)
        return cls(
            ts=task.step * np.arange(paths.shape[-2], dtype=float),
            states=paths,
            commands=np.asarray(commands, float),
            steps=np.asarray(last.step),
            reached=np.asarray(last.reached),
            violated=np.asarray(last.violated),
            arrival_time=np.asarray(last.arrival_time, float),
            clearance=np.asarray(last.clearance, float),
            compute=np.asarray(compute, float),
        )

    def select(self, runs: Int[np.ndarray, " chosen"]) -> "Episodes":
        """Some of many runs, in the order of `runs`."""
        arrays = {
            name: getattr(self, name)[runs]
            for name in self.__dataclass_fields__
            if name not in ("ts", "compute")
        }
        return dataclasses.replace(self, **arrays)


def concatenate_episodes(parts: Sequence[Episodes]) -> Episodes:
    """Episodes of one task, one part after the other."""
    first = parts[0]
    joined = jax.tree.map(lambda *arrays: np.concatenate(arrays), *parts)
    return eqx.tree_at(lambda episodes: episodes.ts, joined, first.ts)


@dataclasses.dataclass(frozen=True, eq=False)
class Step(Generic[Memory]):
    """A control step of an episode.

    Attributes:
        seconds: computing time of the decision [s].
    """

    before: Situation
    memory: Memory
    command: Command
    after: Situation
    seconds: float


def episode(
    task: Task,
    controller: AbstractController[Memory],
    *,
    key: PRNGKeyArray,
    truth: SteeredSwimmer | None = None,
    is_compiled: bool = False,
) -> Iterator[Step[Memory]]:
    """The control steps of one episode, one after the other.

    Args:
        truth: the true swimmer; that of the task unless given.
    """
    decide = partial(_call, controller) if is_compiled else controller
    truth = task.truth if truth is None else truth
    now, memory = begin(task), None
    while not _ended(now, task):
        sensing, deciding, moving = _step_keys(key, now.step)
        observed = observe_compiled(task, now, sensing)
        memory = controller.start(observed) if memory is None else memory
        began = time.perf_counter()
        command, memory = decide(observed, memory, key=deciding)
        jax.block_until_ready(command)
        seconds = time.perf_counter() - began
        before = now
        now, allowed = advance_compiled(task, truth, now, command, moving)
        yield Step(before, memory, allowed, now, seconds)


def last_observation(
    task: Task, situation: Situation, key: PRNGKeyArray
) -> Observation:
    """The observation that a controller would be told at the end of an episode."""
    return observe_compiled(task, situation, _step_keys(key, situation.step)[0])


def run(
    task: Task,
    controller: AbstractController,
    *,
    key: PRNGKeyArray,
    truth: SteeredSwimmer | None = None,
) -> Episodes:
    """One episode, step by step, with the time that each command takes."""
    steps = list(episode(task, controller, key=key, truth=truth, is_compiled=True))
    paths = np.stack([steps[0].before.state, *(step.after.state for step in steps)])
    controls = np.asarray([step.command for step in steps], float)
    compute = [step.seconds for step in steps]
    return Episodes.of(task, steps[-1].after, paths, controls, compute)


def run_many(
    task: Task,
    controller: AbstractController,
    keys: Shaped[PRNGKeyArray, " episode"],
    *,
    truth: SteeredSwimmer | None = None,
) -> Episodes:
    """One episode a key, in one compiled call.

    The noise belongs to its key, whatever the controller: episodes of two controllers
    with the same keys are pairs. On a processor they run one after the other, so that
    early ends cost less; on an accelerator side by side, until the last one ends.
    """
    truth = task.truth if truth is None else truth
    side_by_side = jax.default_backend() != "cpu"
    last, states, commands = jax.block_until_ready(
        _episodes(task, controller, truth, keys, side_by_side=side_by_side)
    )
    return Episodes.of(task, last, states, commands)


_call = eqx.filter_jit(operator.call)
_ended = eqx.filter_jit(Situation.ended)


@eqx.filter_jit
def _episodes(
    task: Task,
    controller: AbstractController,
    truth: SteeredSwimmer,
    keys: Shaped[PRNGKeyArray, " episode"],
    *,
    side_by_side: bool,
) -> tuple[
    Situation, Float[Array, "episode time state"], Float[Array, "episode control dim"]
]:
    episode = partial(_episode, task, controller, truth)
    return jax.vmap(episode)(keys) if side_by_side else jax.lax.map(episode, keys)


def _episode(
    task: Task, controller: AbstractController, truth: SteeredSwimmer, key: PRNGKeyArray
) -> tuple[Situation, Float[Array, "time state"], Float[Array, "control dim"]]:
    """Last situation, states and commands of one run."""
    count, first = control_steps(task), begin(task)
    observed = observe(task, first, _step_keys(key, first.step)[0])
    memory = jax.tree.map(jnp.asarray, controller.start(observed))
    states = jnp.tile(first.state[None], (count + 1, 1))
    commands = jnp.tile(first.pending[-1:], (count, 1))

    def goes_on(carry: _Carry) -> Bool[Array, ""]:
        return ~carry[0].ended(task)

    def step(carry: _Carry) -> _Carry:
        now, memory, states, commands = carry
        sensing, deciding, moving = _step_keys(key, now.step)
        observed = observe(task, now, sensing)
        command, memory = controller(observed, memory, key=deciding)
        later, allowed = advance(task, truth, now, command, moving)
        states = states.at[later.step].set(later.state)
        commands = commands.at[now.step].set(allowed)
        return later, memory, states, commands

    carry = first, memory, states, commands
    last, _, states, commands = jax.lax.while_loop(goes_on, step, carry)
    after = jnp.arange(count + 1)[:, None] > last.step
    return last, jnp.where(after, last.state[None], states), commands


def _step_keys(key: PRNGKeyArray, step: Int[Array, ""]) -> Shaped[PRNGKeyArray, "3"]:
    return jax.random.split(jax.random.fold_in(key, step), 3)
