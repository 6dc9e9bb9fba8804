r"""The true swimmer between two control steps: what is observed, and what moves it.

A command comes into force after the delay and holds for one control step. The true
swimmer takes at least `PARTS` Runge-Kutta steps in it; after each the white noise adds
a normal number of standard deviation $\sigma \sqrt{dt}$ to its velocity (or to its
position where it has no inertia). An episode ends where the task is done, where a
forbidden place is entered, and when time is up.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from pinav.arguments import Scalar, State
from pinav.dynamics import RK4, FixedStep
from pinav.navigation.control.controller import Observation
from pinav.navigation.task.steering import Command, SteeredSwimmer, direction_angles
from pinav.navigation.task.task import Task

PARTS = 4
"""Least number of steps of the true swimmer within a control step."""


class Situation(eqx.Module):
    """The state of an episode.

    Attributes:
        pending: as in `Observation`.
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
        """True where the episode is over."""
        return self.reached | self.violated | (self.step >= control_steps(task))


def mean_thrust(
    task: Task, queue: Float[Array, "command dim"]
) -> Float[np.ndarray, " dim"]:
    """Mean thrust of a control step, by the commands that were in force."""
    actuator, timing = task.truth.actuator, task.timing
    first, second = (np.asarray(actuator(command), float) for command in queue[:2])
    return (timing.remainder * first + timing.rest * second) / task.step


def control_steps(task: Task) -> int:
    """Control steps until the time is up."""
    return math.ceil(task.time_limit / task.step - 1e-9)


def begin(task: Task) -> Situation:
    """The start of an episode: at rest, with the heading to the first target."""
    x = task.start[: task.dim]
    angles = direction_angles(task.objective.target(task.step) - x)
    idle = jnp.append(jnp.zeros_like(angles[:1]), angles)
    return Situation(
        step=jnp.zeros((), int),
        state=task.start,
        pending=jnp.tile(idle[None], (task.timing.waiting, 1)),
        reached=jnp.zeros((), bool),
        violated=jnp.zeros((), bool),
        arrival_time=jnp.full((), jnp.inf, task.start.dtype),
        clearance=task.clearance(x),
    )


def observe(task: Task, situation: Situation, key: PRNGKeyArray) -> Observation:
    """The observation of a controller, with the error of the sensor."""
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


def _judge(
    task: Task, now: Situation, state: State, t: Scalar, duration: Scalar
) -> Situation:
    """The situation with a new state; nothing changes once an episode has ended."""
    over = now.reached | now.violated
    before, x = now.state[: task.dim], state[: task.dim]
    near = task.clearance(x)
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


def _parts(task: Task) -> tuple[Int[Array, " part"], Float[Array, " part"]]:
    """Short steps within a control step: which command is in force, and how long."""
    rows, durations = [], []
    for row, span in enumerate((task.timing.remainder, task.timing.rest)):
        count = math.ceil(PARTS * span / task.step - 1e-9)
        rows += [row] * count
        durations += [span / max(count, 1)] * count
    return jnp.asarray(rows), jnp.asarray(durations, float)


observe_compiled = eqx.filter_jit(observe)
advance_compiled = eqx.filter_jit(advance)
