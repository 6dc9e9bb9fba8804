"""Flights in the true environment of a controller that learns on the way."""

import dataclasses
import math
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, PRNGKeyArray

from pinav.navigation.adaptive.prior import environment_rate
from pinav.navigation.adaptive.steering import Adaptive, Mind
from pinav.navigation.belief.belief import Belief, Frame
from pinav.navigation.belief.given import take_for_granted
from pinav.navigation.task.task import Task
from pinav.navigation.trials.closed_loop import Situation, advance, begin, observe

advance_compiled = eqx.filter_jit(advance)
_observe = eqx.filter_jit(observe)


@dataclasses.dataclass(frozen=True, eq=False)
class Flight:
    """What happened in one flight.

    Attributes:
        states: true states at the frames.
        means: believed states then.
        consistency: squared error of the believed state over its variance, a component.
        leaders: which filter led.
        reached: whether the goal was reached.
        violated: whether a forbidden place was entered.
        arrival_time: [T]; infinite if it was not.
        clearance: least distance from forbidden places [L].
        changed: commands that the safety filter changed.
        stalls: frames at which no progress was noticed.
        learn_times: computing time of each frame [s].
        command_times: computing time of each command [s].
        replan_times: computing time of each later plan [s].
        belief: at the end.
        moments: beliefs on the way, to be shown.
    """

    states: Float[np.ndarray, "frame state"]
    means: Float[np.ndarray, "frame state"]
    consistency: Float[np.ndarray, " frame"]
    leaders: Int[np.ndarray, " frame"]
    reached: bool
    violated: bool
    arrival_time: float
    clearance: float
    changed: int
    stalls: int
    learn_times: Float[np.ndarray, " control"]
    command_times: Float[np.ndarray, " control"]
    replan_times: Float[np.ndarray, " plan"]
    belief: Belief
    moments: tuple[Belief, ...] = ()


def know_truth(adaptive: Adaptive, frame: Frame) -> Belief:
    """The oracle's belief: the true force, and a state that is to be estimated.

    Args:
        adaptive: the controller.
        frame: the first one.

    Raises:
        InputError: the true force changes in time.
    """
    task = adaptive.task
    return take_for_granted(
        environment_rate(task, task.truth),
        frame,
        motion=adaptive.motion,
        speed_sd=adaptive.rest_sd(frame),
        longest=task.step,
    )


def fly(
    adaptive: Adaptive,
    *,
    key: PRNGKeyArray,
    belief: Belief | None = None,
    oracle: bool = False,
    every: float = math.inf,
) -> Flight:
    """One flight, frame by frame; only positions are observed.

    The noise belongs to the key, whatever the controller: flights of two controllers
    with one key are a pair.

    Args:
        adaptive: what decides.
        key: random key of noise, sensor and controller.
        belief: whose map is kept, of an earlier visit; nothing is known unless given.
        oracle: whether the true force is known.
        every: time between the beliefs that are kept, to be shown [T].
    """
    task, now = adaptive.task, begin(adaptive.task)
    frame = see_frame(task, now, np.zeros(2), _keys(key, 0)[0])
    if oracle:
        belief = know_truth(adaptive, frame)
    elif belief is not None:
        belief = belief.restart(frame, speed_sd=adaptive.rest_sd(frame))
    else:
        belief = adaptive.believe(frame)
    mind, record = adaptive.start(belief), _Record(every)
    record.note(now, mind, 0.0)
    while not bool(now.ended(task)):
        keys = _keys(key, int(now.step))
        start = time.perf_counter()
        command, mind = adaptive.command(mind, now.pending, keys[1])
        record.decided(mind, time.perf_counter() - start)
        before = now.pending
        now, allowed = advance_compiled(task, task.truth, now, command, keys[2])
        thrust = mean_thrust(task, jnp.concatenate([before, allowed[None]]))
        sensing = _keys(key, int(now.step))[0]
        frame = see_frame(task, now, thrust, sensing)
        start, planned = time.perf_counter(), mind.planned
        mind = adaptive.learn(mind, frame)
        elapsed = time.perf_counter() - start
        if mind.planned > planned:
            record.replan_times.append(mind.replan_time)
            elapsed -= mind.replan_time
        record.note(now, mind, elapsed)
    return record.flight(now, mind)


def _keys(key: PRNGKeyArray, step: int) -> list[PRNGKeyArray]:
    return list(jax.random.split(jax.random.fold_in(key, step), 3))


def see_frame(
    task: Task,
    now: Situation,
    thrust: Float[np.ndarray, "2"],
    key: PRNGKeyArray,
) -> Frame:
    """What the camera tells: a position, at the time of the control step.

    Args:
        task: whose positions have an error.
        now: the situation.
        thrust: mean one since the last frame.
        key: random key of the error.
    """
    observation = _observe(task, now, key)
    position = np.asarray(observation.state[:2], float)
    return Frame(float(observation.time), position, task.position_sd, thrust)


def mean_thrust(task: Task, queue: jax.Array) -> Float[np.ndarray, "2"]:
    """Mean thrust of the last control step: of what was in force then.

    Args:
        task: whose delay counts.
        queue: pending commands, and the one that was given.
    """
    whole = math.floor(task.delay / task.step + 1e-9)
    part = max(task.delay / task.step - whole, 0.0)
    first, second = (queue[k] for k in ((0, 1) if part > 1e-9 or not whole else (0, 0)))
    actuator = task.truth.actuator
    return np.asarray(part * actuator(first) + (1 - part) * actuator(second), float)


class _Record:
    """Notes on a flight, as it goes."""

    def __init__(self, every: float) -> None:
        self.every, self.next = every, 0.0
        self.states, self.means = [], []
        self.consistency, self.leaders, self.moments = [], [], []
        self.learn_times, self.command_times, self.replan_times = [], [], []
        self.changed = self.stalls = 0

    def note(self, now: Situation, mind: Mind, elapsed: float) -> None:
        """The situation after a frame, and what is believed of it."""
        state, believed = np.asarray(now.state, float), mind.belief.state
        error = state[:2] - believed.mean[:2]
        spread = believed.covariance[:2, :2]
        self.states.append(state)
        self.means.append(believed.mean)
        score = float(error @ np.linalg.solve(spread, error)) / 2
        self.consistency.append(score)
        self.leaders.append(mind.belief.leader)
        self.learn_times.append(elapsed)
        self.stalls += mind.progress.stalled
        if mind.belief.time >= self.next - 1e-9 and math.isfinite(self.every):
            self.moments.append(mind.belief)
            self.next += self.every

    def decided(self, mind: Mind, elapsed: float) -> None:
        """A command was given."""
        self.command_times.append(elapsed)
        self.changed += mind.verdict is not None and mind.verdict.changed

    def flight(self, now: Situation, mind: Mind) -> Flight:
        """The whole flight."""
        return Flight(
            np.stack(self.states),
            np.stack(self.means),
            np.array(self.consistency),
            np.array(self.leaders),
            bool(now.reached),
            bool(now.violated),
            float(now.arrival_time),
            float(now.clearance),
            self.changed,
            self.stalls,
            np.array(self.learn_times[1:]),
            np.array(self.command_times),
            np.array(self.replan_times),
            mind.belief,
            tuple(self.moments),
        )
