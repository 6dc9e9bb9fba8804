"""Navigation tasks by name; all are synthetic.

The controller of a task knows thrust, drag, limits, noise and delay. What it does not
know is the environment, or the current: `training` gives the trajectories from which
it is learned.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from pinav.actuation import (
    AbstractActuator,
    LinearResponse,
    RollingActuator,
    StepOutResponse,
)
from pinav.dynamics import AbstractSwimmer, Swimmer, takes_commands, unbound
from pinav.errors import InputError
from pinav.forces import AbstractCommandedForce, WallMobility
from pinav.navigation.task.steering import CommandLimits, SteeredSwimmer
from pinav.navigation.task.task import (
    AbstractObjective,
    AbstractPath,
    AbstractZone,
    Behind,
    CirclePath,
    Disc,
    FigureEightPath,
    FollowPath,
    LinePath,
    ReachGoal,
    Rectangle,
    Task,
    Wall,
)
from pinav.scenarios import scenario
from pinav.trajectories import Trajectories, simulate

STEP = 0.1
"""How long a command holds [T]."""

STEP_OUT = 1.0
"""Frequency at which all screws of the tasks fall behind the field [cycles T⁻¹]."""


def task(name: str) -> Task:
    """The task of that name.

    Raises:
        InputError: no task has that name.
    """
    return _entry(name)[0](name)


def training(name: str, key: PRNGKeyArray, *, count: int = 8) -> Trajectories:
    """Noisy trajectories in the surroundings of a task, as of a fit before the run.

    They do not know of the task: starts are those of the scenario, and the standard
    deviation of each observed state is 0.02.

    Raises:
        InputError: no task has that name.
    """
    starts, noise = jax.random.split(key)
    return simulate(scenario(_entry(name)[1], starts, count=count), key=noise)


def _entry(name: str) -> tuple[Callable[[str], Task], str]:
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


def _screw(thrust: float) -> tuple[RollingActuator, CommandLimits]:
    """A screw with this greatest thrust, driven at most as fast as that takes.

    It turns with the field below the step-out frequency and falls behind above it; the
    thrust goes with the rate at which it turns, which is the paper's at its greatest.

    References:
        PI-NAV paper, section 2.2.
    """
    response = StepOutResponse(STEP_OUT)
    frequencies = jnp.linspace(0.0, 1.2 * STEP_OUT, 1201)
    turning = response(frequencies)
    best = int(jnp.argmax(turning))
    gain = thrust / float(turning[best])
    limits = CommandLimits(float(frequencies[best]))
    return RollingActuator(gain * jnp.eye(2), response), limits


Place = tuple[float, ...]
"""Coordinates of a place [L]."""


@dataclasses.dataclass(frozen=True)
class Way:
    """A way from a place to a place, and the swimmer that goes it.

    Attributes:
        tolerance: distance from the goal that counts as there [L].
        thrust: greatest thrust, of a swimmer whose own thrust cannot be steered:
            an acceleration where there is inertia, else a force.
        keep_out: centre and radius of each disc, or ball, that must not be entered [L].
        arena: lower and upper corner of what must not be left [L]; around start, goal
            and data unless given.
        step: time for which a command holds [T].
        time_limit: time after which a run has failed [T].
        noise: strength of the white noise, as in `Task`.
        sensor_noise: standard deviation of what the controller is told of the state.
        delay: time from command to motion [T]; that of the propulsion unless given.
        frequency: greatest frequency, of a swimmer whose propulsion takes frequency and
            heading [cycles T⁻¹].
    """

    start: Place
    goal: Place
    tolerance: float = 0.3
    thrust: float = 0.8
    keep_out: tuple[Place, ...] = ()
    arena: tuple[Place, Place] | None = None
    step: float = 0.1
    time_limit: float = 20.0
    noise: float = 0.1
    sensor_noise: float = 0.0
    delay: float | None = None
    frequency: float = 10.0

    def task(
        self,
        model: AbstractSwimmer,
        truth: AbstractSwimmer,
        name: str,
        places: Float[np.ndarray, "place dim"] | None = None,
    ) -> Task:
        """The task of a swimmer.

        The actuator is the propulsion of the model where that takes frequency and
        heading; a swimmer whose thrust cannot be steered gets one that can. The wall of
        a mobility must not be touched.

        Args:
            model: swimmer whose propulsion is steered.
            places: further places that the arena surrounds [L]; none unless given.

        Raises:
            InputError: the places have not the same number of coordinates.
        """
        if len(self.start) != len(self.goal):
            raise InputError(
                f"Way: expected start and goal with as many coordinates, got "
                f"{self.start} and {self.goal}"
            )
        actuator, limits, lag = self._actuation(model)
        rest = [0.0] * len(self.start) if isinstance(truth, Swimmer) else []
        zones = [Disc(list(middle), radius) for *middle, radius in self.keep_out]
        mobility = getattr(model, "mobility", None)
        if isinstance(mobility, WallMobility):
            zones = [*zones, Behind(mobility.wall, mobility.radius)]
        return Task(
            name=name,
            truth=SteeredSwimmer(truth, actuator),
            start=jnp.asarray([*self.start, *rest]),
            objective=ReachGoal(list(self.goal), self.tolerance),
            limits=limits,
            arena=self._arena(places),
            keep_out=tuple(zones),
            step=self.step,
            time_limit=self.time_limit,
            noise=self.noise,
            sensor_noise=self.sensor_noise,
            delay=lag if self.delay is None else self.delay,
        )

    def _actuation(
        self, model: AbstractSwimmer
    ) -> tuple[AbstractActuator, CommandLimits, float]:
        """The effect of commands, their limits, and the time until motion [T]."""
        propulsion = unbound(model) if takes_commands(model) else model.propulsion
        if not isinstance(propulsion, AbstractCommandedForce):
            gain = self.thrust * jnp.eye(len(self.start))
            return RollingActuator(gain, LinearResponse()), CommandLimits(1.0), 0.0
        limits = CommandLimits(self.frequency)
        return propulsion.actuator, limits, propulsion.lateness

    def _arena(self, places: Float[np.ndarray, "place dim"] | None) -> Rectangle:
        """The arena that was given, or one around start, goal and further places."""
        if self.arena is not None:
            lower, upper = self.arena
            return Rectangle(list(lower), list(upper))
        ends = np.array([self.start, self.goal])
        margin = 0.25 * float(np.linalg.norm(ends[1] - ends[0])) + self.tolerance
        inside = np.concatenate([ends - margin, ends + margin])
        if places is not None:
            inside = np.concatenate([inside, places])
        return Rectangle(inside.min(axis=0), inside.max(axis=0))


TASKS: dict[str, tuple[Callable[[str], Task], str]] = {
    # Past the paper's barrier of 1.10. The straight way leads over its top, which no
    # run-up from rest reaches with the weak thrust; or it circles, once in 20.
    "barrier-weak": (partial(_crossing, thrust=0.8), "barrier-crossings"),
    "barrier-strong": (partial(_crossing, thrust=1.5), "barrier-crossings"),
    "rotating-barrier": (partial(_crossing, thrust=0.8), "moving-barrier"),
    # The weak one with two discs on the quick ways around it.
    "keep-out": (
        lambda name: _crossing(
            name, 0.8, (Disc([8.0, -1.5], 1.2), Disc([-1.5, 8.0], 1.2))
        ),
        "barrier-crossings",
    ),
    # Across twelve barriers, or fibres, most of which the thrust cannot climb.
    "many-barriers": (_traverse, "many-barriers"),
    "fibres": (_traverse, "fibres"),
    # With speed 1: against a shear of rate 0.2, where the quick way is not straight;
    # upstream in a Poiseuille flow of 0.7; across a vortex of at most 0.85.
    "shear": (partial(_zermelo, start=[2.0, 2.0], goal=[8.0, 2.5]), "shear-current"),
    "channel": (
        partial(_zermelo, start=[8.0, 3.0], goal=[2.0, 3.5]),
        "channel-current",
    ),
    "vortex": (partial(_zermelo, start=[1.0, 5.0], goal=[9.0, 5.0]), "vortex-current"),
    # Keep up with a point on a path, in an unknown drift, with a delay of 0.2.
    "follow-line": (
        lambda name: _follow_task(name, LinePath([1.5, 2.0], [8.5, 8.0], 20.0), 20.0),
        "drift-current",
    ),
    "follow-circle": (
        lambda name: _follow_task(name, CirclePath([5.0, 5.0], 2.5, 30.0), 30.0),
        "drift-current",
    ),
    "follow-eight": (
        lambda name: _follow_task(name, FigureEightPath([5.0, 5.0], 3.0, 50.0), 50.0),
        "drift-current",
    ),
    # Into the upper branch of a vessel that is 1.04 wide, in a drift that leads to the
    # lower one; images, and so commands, are late by 0.2.
    "y-junction": (
        lambda name: _drift_task(
            name, [0.7, 5.0], ReachGoal([7.5, 8.25], 0.3), _vessel()
        ),
        "drift-current",
    ),
}
"""Each task by its name, and the scenario in which its swimmers are observed."""
