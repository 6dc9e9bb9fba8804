"""Navigation tasks by name; all are synthetic.

The controller of a task knows thrust, drag, limits, noise and delay. What it does not
know is the environment, or the current: `training` gives the trajectories from which
it is learned.
"""

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from pinav.actuation import StepOutResponse
from pinav.errors import InputError
from pinav.navigation.objectives import Reach
from pinav.navigation.steering import CommandLimits, HelicalActuator, SteeredSwimmer
from pinav.navigation.task import Task
from pinav.navigation.zones import Rectangle
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


def shear() -> Task:
    """Against a shear of rate 0.2 with speed 1: the quick way is not straight."""
    return _zermelo("shear", start=[2.0, 2.0], goal=[8.0, 2.5])


def channel() -> Task:
    """Upstream in a Poiseuille flow of speed 0.8, with speed 1."""
    return _zermelo("channel", start=[8.0, 4.0], goal=[2.0, 4.5])


def vortex() -> Task:
    """Across a vortex that is at most 0.85 as fast as the swimmer."""
    return _zermelo("vortex", start=[1.0, 5.0], goal=[9.0, 5.0])


TASKS: dict[str, tuple[Callable[[], Task], str]] = {
    "barrier-weak": (barrier_weak, "barrier-crossings"),
    "barrier-strong": (barrier_strong, "barrier-crossings"),
    "shear": (shear, "shear-current"),
    "channel": (channel, "channel-current"),
    "vortex": (vortex, "vortex-current"),
}
"""Each task by its name, and the scenario in which its surroundings are observed."""


def task(name: str) -> Task:
    """The task of that name.

    Raises:
        InputError: no task has that name.
    """
    return TASKS[_known(name)][0]()


def training(name: str, key: PRNGKeyArray, *, count: int = 8) -> Trajectories:
    """Noisy trajectories in the surroundings of a task, as of a fit before the run.

    They do not know of the task: starts are those of the scenario, and the standard
    deviation of each observed state is 0.02.

    Args:
        name: of the task.
        key: random key of starts and noise.
        count: number of trajectories.

    Raises:
        InputError: no task has that name.
    """
    starts, noise = jax.random.split(key)
    return simulate(scenario(TASKS[_known(name)][1], starts, count=count), key=noise)


def _known(name: str) -> str:
    if name not in TASKS:
        known = ", ".join(sorted(TASKS))
        raise InputError(f"task {name!r} is unknown; choose one of: {known}")
    return name


def _crossing(name: str, thrust: float) -> Task:
    actuator, limits = _screw(thrust)
    return Task(
        name=name,
        truth=SteeredSwimmer(scenario(TASKS[name][1]).swimmer, actuator),
        start=jnp.array([0.5, 1.0, 0.0, 0.0]),
        objective=Reach([9.5, 9.5], 0.3),
        limits=limits,
        arena=Rectangle([-3.0, -3.0], [13.0, 13.0]),
        keep_out=(),
        step=STEP,
        time_limit=20.0,
        noise=0.1,
    )


def _zermelo(name: str, *, start: list[float], goal: list[float]) -> Task:
    actuator, limits = _screw(1.0)
    return Task(
        name=name,
        truth=SteeredSwimmer(scenario(TASKS[name][1]).swimmer, actuator),
        start=jnp.asarray(start),
        objective=Reach(goal, 0.3),
        limits=limits,
        arena=Rectangle([-1.0, -1.0], [11.0, 11.0]),
        keep_out=(),
        step=STEP,
        time_limit=30.0,
        noise=0.02,
    )


def _screw(
    thrust: float, max_turning_rate: float = math.inf
) -> tuple[HelicalActuator, CommandLimits]:
    """A screw with this greatest thrust, driven at most as fast as that takes."""
    frequencies = jnp.linspace(0.0, 1.2 * STEP_OUT, 1201)
    turning = StepOutResponse.of(STEP_OUT)(frequencies)
    best = int(jnp.argmax(turning))
    torque_per_rate = 1 / (2 * math.pi)
    actuator = HelicalActuator(
        gain=thrust / float(turning[best]),
        moment=1.0,
        amplitude=STEP_OUT,
        rotational_drag=torque_per_rate,
    )
    return actuator, CommandLimits(float(frequencies[best]), max_turning_rate)
