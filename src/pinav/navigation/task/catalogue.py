"""Navigation tasks by name; all are synthetic.

The controller of a task knows thrust, drag, limits, noise and delay. What it does not
know is the environment, or the current: `training` gives the trajectories from which
it is learned.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from pinav.actuation import StepOutResponse
from pinav.errors import InputError
from pinav.navigation.task.objectives import (
    AbstractObjective,
    AbstractPath,
    CirclePath,
    FigureEightPath,
    FollowPath,
    LinePath,
    ReachGoal,
)
from pinav.navigation.task.steering import (
    CommandLimits,
    HelicalActuator,
    SteeredSwimmer,
)
from pinav.navigation.task.task import AbstractZone, Disc, Rectangle, Task, Wall
from pinav.scenarios import scenario
from pinav.trajectories import Trajectories, simulate

STEP = 0.1
"""How long a command holds [T]."""

STEP_OUT = 1.0
"""Frequency at which all screws of the tasks fall behind the field [cycles T⁻¹]."""


def barrier_weak() -> Task:
    """Past the paper's barrier with a thrust of 0.8: less than the barrier's 1.10.

    The straight way leads over its top, which no run-up from rest reaches.
    """
    return _crossing("barrier-weak", 0.8)


def barrier_strong() -> Task:
    """Past the paper's barrier with a thrust of 1.5: more than the barrier's 1.10."""
    return _crossing("barrier-strong", 1.5)


def rotating_barrier() -> Task:
    """Past the paper's barrier while it circles, once in 20, with a thrust of 0.8."""
    return _crossing("rotating-barrier", 0.8)


def keep_out() -> Task:
    """The barrier of `barrier_weak`, with two discs on the quick ways around it."""
    discs = Disc([8.0, -1.5], 1.2), Disc([-1.5, 8.0], 1.2)
    return _crossing("keep-out", 0.8, discs)


def many_barriers() -> Task:
    """Across twelve barriers, most of which the thrust of 0.6 cannot climb."""
    return _traverse("many-barriers")


def fibres() -> Task:
    """Across twelve fibres, most of which the thrust of 0.6 cannot climb."""
    return _traverse("fibres")


def shear() -> Task:
    """Against a shear of rate 0.2 with speed 1: the quick way is not straight."""
    return _zermelo("shear", start=[2.0, 2.0], goal=[8.0, 2.5])


def channel() -> Task:
    """Upstream in a Poiseuille flow of speed 0.7, with speed 1."""
    return _zermelo("channel", start=[8.0, 3.0], goal=[2.0, 3.5])


def vortex() -> Task:
    """Across a vortex that is at most 0.85 as fast as the swimmer."""
    return _zermelo("vortex", start=[1.0, 5.0], goal=[9.0, 5.0])


def follow_line() -> Task:
    """Keep up with a point on a line, in an unknown drift, with a delay of 0.2."""
    return _follow_task("follow-line", LinePath([1.5, 2.0], [8.5, 8.0], 20.0), 20.0)


def follow_circle() -> Task:
    """Keep up with a point on a circle, in an unknown drift, with a delay of 0.2."""
    return _follow_task("follow-circle", CirclePath([5.0, 5.0], 2.5, 30.0), 30.0)


def follow_eight() -> Task:
    """Keep up with a point on a figure eight, in an unknown drift, delayed by 0.2."""
    return _follow_task("follow-eight", FigureEightPath([5.0, 5.0], 3.0, 50.0), 50.0)


def y_junction() -> Task:
    """Into the upper branch of a vessel, in a drift that leads to the lower one.

    The vessel is 1.04 wide; images, and so commands, are late by 0.2.
    """
    return _drift_task("y-junction", [0.7, 5.0], ReachGoal([7.5, 8.25], 0.3), _vessel())


TASKS: dict[str, tuple[Callable[[], Task], str]] = {
    "barrier-weak": (barrier_weak, "barrier-crossings"),
    "barrier-strong": (barrier_strong, "barrier-crossings"),
    "rotating-barrier": (rotating_barrier, "moving-barrier"),
    "keep-out": (keep_out, "barrier-crossings"),
    "many-barriers": (many_barriers, "many-barriers"),
    "fibres": (fibres, "fibres"),
    "shear": (shear, "shear-current"),
    "channel": (channel, "channel-current"),
    "vortex": (vortex, "vortex-current"),
    "follow-line": (follow_line, "drift-current"),
    "follow-circle": (follow_circle, "drift-current"),
    "follow-eight": (follow_eight, "drift-current"),
    "y-junction": (y_junction, "drift-current"),
}
"""Each task by its name, and the scenario in which its swimmers are observed."""


def task(name: str) -> Task:
    """The task of that name.

    Raises:
        InputError: no task has that name.
    """
    return _entry(name)[0]()


def training(name: str, key: PRNGKeyArray, *, count: int = 8) -> Trajectories:
    """Noisy trajectories in the surroundings of a task, as of a fit before the run.

    They do not know of the task: starts are those of the scenario, and the standard
    deviation of each observed state is 0.02.

    Raises:
        InputError: no task has that name.
    """
    starts, noise = jax.random.split(key)
    return simulate(scenario(_entry(name)[1], starts, count=count), key=noise)


def _entry(name: str) -> tuple[Callable[[], Task], str]:
    if name not in TASKS:
        known = ", ".join(sorted(TASKS))
        raise InputError(f"task {name!r} is unknown; choose one of: {known}")
    return TASKS[name]


def _screw_task(
    name: str,
    thrust: float,
    start: Any,
    objective: AbstractObjective,
    sides: tuple[float, float],
    time_limit: float,
) -> Task:
    """A screw in a square arena without zones, in noise that a swimmer feels."""
    actuator, limits = _screw(thrust)
    low, high = sides
    return Task(
        name=name,
        truth=SteeredSwimmer(scenario(TASKS[name][1]).true_swimmer, actuator),
        start=jnp.asarray(start),
        objective=objective,
        limits=limits,
        arena=Rectangle([low, low], [high, high]),
        keep_out=(),
        step=STEP,
        time_limit=time_limit,
        noise=0.1,
    )


def _crossing(name: str, thrust: float, zones: tuple[AbstractZone, ...] = ()) -> Task:
    goal = ReachGoal([9.5, 9.5], 0.3)
    task = _screw_task(name, thrust, [0.5, 1.0, 0.0, 0.0], goal, (-4.0, 14.0), 24.0)
    return dataclasses.replace(task, keep_out=zones)


def _traverse(name: str) -> Task:
    goal = ReachGoal([18.5, 18.5], 0.4)
    return _screw_task(name, 0.6, [1.5, 1.5, 0.0, 0.0], goal, (-2.0, 22.0), 60.0)


def _zermelo(name: str, *, start: list[float], goal: list[float]) -> Task:
    task = _screw_task(name, 1.0, start, ReachGoal(goal, 0.3), (-1.0, 11.0), 30.0)
    return dataclasses.replace(task, noise=0.02)


def _follow_task(name: str, path: AbstractPath, duration: float) -> Task:
    return _drift_task(name, path(0.0), FollowPath(path), time_limit=duration)


def _drift_task(
    name: str,
    start: Any,
    objective: AbstractObjective,
    zones: tuple[AbstractZone, ...] = (),
    time_limit: float = 30.0,
) -> Task:
    """With an unknown drift, a camera's error and delay, and coils that turn slowly."""
    task = _screw_task(name, 1.0, start, objective, (-1.0, 11.0), time_limit)
    return dataclasses.replace(
        task,
        limits=CommandLimits(task.limits.max_frequency, max_turning_rate=4.0),
        keep_out=zones,
        noise=0.05,
        sensor_noise=0.02,
        delay=0.2,
    )


def _vessel() -> tuple[AbstractZone, ...]:
    """Walls of a vessel that parts into two, at 45 degrees."""
    lines = (
        ([-1.0, 5.6], [4.0, 5.6]),
        ([4.0, 5.6], [8.0, 9.6]),
        ([5.1, 5.0], [9.1, 9.0]),
    )
    mirrored = [([a, 10 - b], [c, 10 - d]) for (a, b), (c, d) in lines]
    return tuple(Wall(start, end, 0.08) for start, end in (*lines, *mirrored))


def _screw(thrust: float) -> tuple[HelicalActuator, CommandLimits]:
    """A screw with this greatest thrust, driven at most as fast as that takes."""
    frequencies = jnp.linspace(0.0, 1.2 * STEP_OUT, 1201)
    turning = StepOutResponse(STEP_OUT)(frequencies)
    best = int(jnp.argmax(turning))
    torque_per_rate = 1 / (2 * math.pi)
    actuator = HelicalActuator(
        gain=thrust / float(turning[best]),
        moment=1.0,
        amplitude=STEP_OUT,
        rotational_drag=torque_per_rate,
    )
    return actuator, CommandLimits(float(frequencies[best]))
