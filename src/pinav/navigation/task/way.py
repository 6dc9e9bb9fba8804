"""A way from a place to a place, as a task of a swimmer."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.actuation import AbstractActuator, LinearResponse, RollingActuator
from pinav.dynamics import OverdampedSwimmer, Swimmer, takes_commands, unbound
from pinav.errors import InputError
from pinav.forces import AbstractCommandedForce, WallMobility
from pinav.navigation.task.objectives import ReachGoal
from pinav.navigation.task.steering import CommandLimits, SteeredSwimmer
from pinav.navigation.task.task import Behind, Disc, Rectangle, Task

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
        model: Swimmer | OverdampedSwimmer,
        truth: Swimmer | OverdampedSwimmer,
        name: str,
        places: Float[np.ndarray, "place dim"] | None = None,
    ) -> Task:
        """The task of a swimmer.

        The actuator is the propulsion of the model where that takes frequency and
        heading; a swimmer whose thrust cannot be steered gets one that can. The wall of
        a mobility must not be touched.

        Args:
            model: swimmer whose propulsion is steered.
            truth: the true swimmer.
            name: name of the task.
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
        discs = (Disc(list(middle), radius) for *middle, radius in self.keep_out)
        return Task(
            name=name,
            truth=SteeredSwimmer(truth, actuator),
            start=jnp.asarray([*self.start, *rest]),
            objective=ReachGoal(list(self.goal), self.tolerance),
            limits=limits,
            arena=self._arena(places),
            keep_out=(*discs, *_walls(model)),
            step=self.step,
            time_limit=self.time_limit,
            noise=self.noise,
            sensor_noise=self.sensor_noise,
            delay=lag if self.delay is None else self.delay,
        )

    def _actuation(
        self, model: Swimmer | OverdampedSwimmer
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


def _walls(model: Swimmer | OverdampedSwimmer) -> tuple[Behind, ...]:
    """The wall that the mobility knows, which the swimmer's surface must not touch."""
    mobility = getattr(model, "mobility", None)
    if not isinstance(mobility, WallMobility):
        return ()
    return (Behind(mobility.wall, mobility.radius),)
