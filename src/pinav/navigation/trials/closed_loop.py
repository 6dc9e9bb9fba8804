r"""A controller steers the true swimmer: one episode, or many at once.

At every control step the controller observes the state, with the error of the sensor,
and gives a command, which comes into force after the delay and holds for one step. The
true swimmer takes at least `PARTS` Runge-Kutta steps; after each the white noise adds a
normal number of standard deviation $\sigma \sqrt{dt}$ to its velocity (or to its
position where it has no inertia). An episode ends where the task is done, where a
forbidden place is entered, and when time is up.
"""

import dataclasses
import math
import time
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Generic

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int, PRNGKeyArray, PyTree, Shaped

from pinav.arguments import Scalar, State
from pinav.dynamics import RK4, FixedStep
from pinav.navigation.control.controller import AbstractController, Memory, Observation
from pinav.navigation.task.steering import (
    Command,
    SteeredSwimmer,
    direction_angles,
)
from pinav.navigation.task.task import Task
from pinav.navigation.task.zones import clearance

PARTS = 4
"""Least number of steps of the true swimmer within a control step."""


class Situation(eqx.Module):
    """Where an episode stands.

    Attributes:
        step: control steps taken.
        state: the true state.
        pending: as in `Observation`.
        reached: whether the task is done.
        violated: whether a forbidden place was entered, or the state is lost.
        arrival_time: when it was done [T]; infinite until then.
        clearance: least distance from forbidden places so far [L].
    """

    step: Int[Array, ""]
    state: State
    pending: Float[Array, "command dim"]
    reached: Bool[Array, ""]
    violated: Bool[Array, ""]
    arrival_time: Float[Array, ""]
    clearance: Float[Array, ""]

    def ended(self, task: Task) -> Bool[Array, ""]:
        """Whether the episode is over."""
        return self.reached | self.violated | (self.step >= control_steps(task))


_Carry = tuple[
    Situation, PyTree, Float[Array, "time state"], Float[Array, "control dim"]
]
"""Situation, memory of the controller, states and commands of an episode so far."""


class Episodes(eqx.Module):
    """What happened in one run, or in many: then runs are the first axis of all but ts.

    After the end of a run its last state stays.

    Attributes:
        ts: times of the control steps [T].
        states: true states then.
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


def mean_thrust(
    task: Task, queue: Float[Array, "command dim"]
) -> Float[np.ndarray, " dim"]:
    """Mean thrust of a control step, by the commands that were in force.

    Args:
        task: whose delay counts.
        queue: commands that were pending at its beginning, and later ones.
    """
    whole = math.floor(task.delay / task.step + 1e-9)
    part = max(task.delay / task.step - whole, 0.0)
    first, second = (queue[k] for k in ((0, 1) if part > 1e-9 or not whole else (0, 0)))
    actuator = task.truth.actuator
    return np.asarray(part * actuator(first) + (1 - part) * actuator(second), float)


def control_steps(task: Task) -> int:
    """Control steps until the time is up."""
    return math.ceil(task.time_limit / task.step - 1e-9)


def begin(task: Task) -> Situation:
    """The start of an episode: at rest, with the heading to the first target."""
    x = task.start[: task.dim]
    angles = direction_angles(task.objective.target(task.step) - x)
    idle = jnp.append(jnp.zeros_like(angles[:1]), angles)
    whole, part = _delay(task)
    return Situation(
        step=jnp.zeros((), int),
        state=task.start,
        pending=jnp.tile(idle[None], (max(whole + (part > 0), 1), 1)),
        reached=jnp.zeros((), bool),
        violated=jnp.zeros((), bool),
        arrival_time=jnp.full((), jnp.inf, task.start.dtype),
        clearance=clearance(x, task.keep_out, task.arena),
    )


def observe(task: Task, situation: Situation, key: PRNGKeyArray) -> Observation:
    """What the controller is told, with the error of the sensor."""
    state = situation.state
    error = task.sensor_noise * jax.random.normal(key, state.shape, state.dtype)
    now = task.step * situation.step.astype(state.dtype)
    return Observation(now, state + error, situation.pending)


def advance(
    task: Task,
    truth: SteeredSwimmer,
    situation: Situation,
    command: Command,
    key: PRNGKeyArray,
) -> tuple[Situation, Command]:
    """One control step of the true swimmer.

    Args:
        task: what is to be done.
        truth: the true swimmer.
        situation: before the step.
        command: what the controller wants, within the limits or not.
        key: of the white noise.

    Returns:
        The situation after it, and the command within the limits.
    """
    allowed = task.limits.clip(command, situation.pending[-1], task.step)
    queue = jnp.concatenate([situation.pending, allowed[None]])
    rows, durations = _parts(task)
    state = situation.state
    start = task.step * situation.step.astype(state.dtype)
    durations = durations.astype(state.dtype)
    times = start + jnp.cumsum(durations) - durations
    kicks = _kicks(task, durations, key, state)

    def substep(
        now: Situation, inputs: tuple[Int[Array, ""], Scalar, Scalar, State]
    ) -> tuple[Situation, None]:
        row, t, duration, kick = inputs
        held = truth.under(queue[row])
        later = FixedStep(RK4).step(held, now.state, t, t + duration) + kick
        return _judge(task, now, later, t, duration), None

    inputs = (rows, times, durations, kicks)
    later, _ = jax.lax.scan(substep, situation, inputs)
    later = eqx.tree_at(
        lambda s: (s.step, s.pending), later, (situation.step + 1, queue[1:])
    )
    return later, allowed


@dataclasses.dataclass(frozen=True, eq=False)
class Step(Generic[Memory]):
    """A control step of an episode.

    Attributes:
        before: the situation in which the controller decides.
        memory: of the controller after its decision.
        command: what was commanded, within the limits.
        after: the situation at the end of the step.
        seconds: computing time of the decision [s].
    """

    before: Situation
    memory: Memory
    command: Command
    after: Situation
    seconds: float


class Compiled(AbstractController[Memory], Generic[Memory]):
    """A controller whose decisions are compiled.

    Attributes:
        controller: what decides; it can be traced.
    """

    controller: AbstractController[Memory]

    def start(self, observation: Observation) -> Memory:
        return self.controller.start(observation)

    def __call__(
        self, observation: Observation, memory: Memory, *, key: PRNGKeyArray
    ) -> tuple[Command, Memory]:
        return _decide(self.controller, observation, memory, key)


def episode(
    task: Task,
    controller: AbstractController[Memory],
    *,
    key: PRNGKeyArray,
    truth: SteeredSwimmer | None = None,
) -> Iterator[Step[Memory]]:
    """The control steps of one episode, one after the other.

    Args:
        task: what is to be done.
        controller: what decides, as it is; see `Compiled`.
        key: random key of noise, sensor and controller.
        truth: another true swimmer than that of the task.
    """
    truth = task.truth if truth is None else truth
    now, memory = begin(task), None
    while not _ended(now, task):
        sensing, deciding, moving = _step_keys(key, now.step)
        observed = observe_compiled(task, now, sensing)
        memory = controller.start(observed) if memory is None else memory
        began = time.perf_counter()
        command, memory = controller(observed, memory, key=deciding)
        jax.block_until_ready(command)
        seconds = time.perf_counter() - began
        before = now
        now, allowed = advance_compiled(task, truth, now, command, moving)
        yield Step(before, memory, allowed, now, seconds)


def last_observation(
    task: Task, situation: Situation, key: PRNGKeyArray
) -> Observation:
    """The observation that a controller would be told at the end of an episode.

    Args:
        task: what was to be done.
        situation: at the end.
        key: random key of the episode.
    """
    return observe_compiled(task, situation, _step_keys(key, situation.step)[0])


def run(
    task: Task,
    controller: AbstractController,
    *,
    key: PRNGKeyArray,
    truth: SteeredSwimmer | None = None,
) -> Episodes:
    """One episode, step by step, with the time that each command takes.

    Args:
        task: what is to be done.
        controller: what decides.
        key: random key of noise, sensor and controller.
        truth: another true swimmer than that of the task.
    """
    steps = list(episode(task, Compiled(controller), key=key, truth=truth))
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

    Args:
        task: what is to be done.
        controller: what decides.
        keys: random keys.
        truth: another true swimmer than that of the task.
    """
    truth = task.truth if truth is None else truth
    side_by_side = jax.default_backend() != "cpu"
    last, states, commands = jax.block_until_ready(
        _episodes(task, controller, truth, keys, side_by_side=side_by_side)
    )
    return Episodes.of(task, last, states, commands)


@eqx.filter_jit
def _decide(
    controller: AbstractController[Memory],
    observation: Observation,
    memory: Memory,
    key: PRNGKeyArray,
) -> tuple[Command, Memory]:
    return controller(observation, memory, key=key)


observe_compiled = eqx.filter_jit(observe)
advance_compiled = eqx.filter_jit(advance)
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


def _judge(
    task: Task, now: Situation, state: State, t: Scalar, duration: Scalar
) -> Situation:
    """The situation with a new state; nothing changes once an episode has ended."""
    over = now.reached | now.violated
    before, x = now.state[: task.dim], state[: task.dim]
    near = clearance(x, task.keep_out, task.arena)
    violated = ~(near >= 0)  # so that a lost state ends the episode, too
    reached = task.objective.is_reached(x) & ~violated
    fraction = _fraction_before(*map(task.objective.distance, (before, x)))
    arrival = jnp.where(reached, t + fraction * duration, now.arrival_time)
    later = Situation(
        now.step,
        state,
        now.pending,
        reached,
        violated,
        arrival,
        jnp.minimum(now.clearance, near),
    )
    return jax.tree.map(lambda old, new: jnp.where(over, old, new), now, later)


def _fraction_before(before: Scalar, after: Scalar) -> Float[Array, ""]:
    """Fraction of a short step after which the task was done, by its distances."""
    gain = before - after
    crossing = before / jnp.where(gain > 0, gain, 1.0)
    return jnp.where(gain > 0, jnp.clip(crossing, 0.0, 1.0), 1.0)


def _kicks(
    task: Task, durations: Float[Array, " part"], key: PRNGKeyArray, state: State
) -> Float[Array, "part state"]:
    """White noise of every short step: of the velocity where there is inertia."""
    numbers = jax.random.normal(key, (durations.shape[0], state.shape[0]), state.dtype)
    moved = jnp.arange(state.shape[0]) >= state.shape[0] - task.dim
    strength = task.noise * jnp.sqrt(durations)[:, None]
    return jnp.where(moved[None], strength * numbers, 0.0)


def _delay(task: Task) -> tuple[int, float]:
    """Whole control steps of the delay, and what is left of it [T]."""
    whole = math.floor(task.delay / task.step + 1e-9)
    part = task.delay - whole * task.step
    return whole, part if part > 1e-9 * task.step else 0.0


def _parts(task: Task) -> tuple[Int[Array, " part"], Float[Array, " part"]]:
    """Short steps within a control step: which command is in force, and how long."""
    whole, part = _delay(task)
    spans = [(0, part), (1, task.step - part)]
    if part == 0:
        spans = [(0 if whole else 1, task.step)]
    rows, durations = [], []
    for row, span in spans:
        count = math.ceil(PARTS * span / task.step - 1e-9)
        rows += [row] * count
        durations += [span / count] * count
    return jnp.asarray(rows), jnp.asarray(durations, float)


def _step_keys(key: PRNGKeyArray, step: Int[Array, ""]) -> Shaped[PRNGKeyArray, "3"]:
    return jax.random.split(jax.random.fold_in(key, step), 3)
