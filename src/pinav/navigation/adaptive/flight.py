"""Flights in the true environment of a controller that learns on the way."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import PRNGKeyArray

from pinav.navigation.adaptive.scores import Flight, score_force
from pinav.navigation.adaptive.steering import AdaptiveController, ControllerState
from pinav.navigation.belief.belief import Belief
from pinav.navigation.trials.closed_loop import episode, last_observation
from pinav.navigation.trials.situation import Situation


class Visit(NamedTuple):
    """A flight, and what is believed after it."""

    flight: Flight
    belief: Belief
    moments: tuple[Belief, ...]


def fly(
    adaptive: AdaptiveController,
    *,
    key: PRNGKeyArray,
    every: float = math.inf,
) -> Visit:
    """One flight, frame by frame; only positions are observed.

    The noise belongs to the key, whatever the controller: flights of two controllers
    with one key are a pair.

    Args:
        adaptive: what decides.
        key: random key of noise, sensor and controller.
        every: time between the beliefs that are kept, to be shown [T].
    """
    task, notes, now, memory = adaptive.task, _Notes(every), None, None
    for step in episode(task, adaptive, key=key):
        notes.frame(step.before, step.memory)
        notes.decision(step.memory)
        now, memory = step.after, step.memory
    assert now is not None
    assert memory is not None
    memory = adaptive.learn(memory, last_observation(task, now, key))
    notes.frame(now, memory)
    path = np.stack(notes.states)[:, :2]
    error, cover = score_force(path, memory.belief, task)
    flight = Flight(
        path=path,
        reached=bool(now.reached),
        violated=bool(now.violated),
        arrival_time=float(now.arrival_time),
        clearance=float(now.clearance),
        consistency=float(np.mean(notes.consistency[1:])),
        changed=notes.changed,
        stalls=notes.stalls,
        learn_times=np.array(notes.learn_times),
        command_times=np.array(notes.command_times),
        replan_times=np.array(notes.replan_times),
        memory=memory.belief.nbytes,
        force_error=error,
        cover=cover,
    )
    return Visit(flight, memory.belief, tuple(notes.moments))


@dataclasses.dataclass
class _Notes:
    """Notes on a flight, as it goes."""

    every: float
    due: float = 0.0
    stalls: int = 0
    changed: int = 0
    states: list[np.ndarray] = dataclasses.field(default_factory=list)
    consistency: list[float] = dataclasses.field(default_factory=list)
    moments: list[Belief] = dataclasses.field(default_factory=list)
    learn_times: list[float] = dataclasses.field(default_factory=list)
    command_times: list[float] = dataclasses.field(default_factory=list)
    replan_times: list[float] = dataclasses.field(default_factory=list)

    def frame(self, now: Situation, memory: ControllerState) -> None:
        """The situation after a frame, and what is believed of it."""
        state, believed = np.asarray(now.state, float), memory.belief.state
        error = state[:2] - believed.mean[:2]
        spread = believed.covariance[:2, :2]
        self.states.append(state)
        self.consistency.append(float(error @ np.linalg.solve(spread, error)) / 2)
        self.stalls += memory.progress.stalled
        if math.isfinite(memory.learn_time):
            self.learn_times.append(memory.learn_time)
        if math.isfinite(memory.plan_time):
            self.replan_times.append(memory.plan_time)
        if memory.belief.time >= self.due - 1e-9 and math.isfinite(self.every):
            self.moments.append(memory.belief)
            self.due += self.every

    def decision(self, memory: ControllerState) -> None:
        """A command was given."""
        self.command_times.append(memory.command_time)
        self.changed += memory.verdict is not None and memory.verdict.changed
