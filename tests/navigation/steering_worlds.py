"""Small tasks with closed forms, and controllers that do what they are told."""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.actuation import LinearResponse
from pinav.dynamics import RK4, FixedStep, OverdampedSwimmer, Swimmer
from pinav.forces import LinearDrag, ZeroForce
from pinav.navigation.control.controller import AbstractController
from pinav.navigation.predictors import AbstractPredictor
from pinav.navigation.task.steering import (
    CommandLimits,
    RollingActuator,
    SteeredSwimmer,
)
from pinav.navigation.task.task import ReachGoal, Rectangle, Task

DRAG = 0.5


class SwimmerPredictor(AbstractPredictor):
    """A model itself, by a Runge-Kutta step."""

    swimmer: SteeredSwimmer

    def step(self, t, y, command, duration):
        held = self.swimmer.under(command)
        return FixedStep(RK4).looped_step(held, y, t, t + jnp.asarray(duration))


class Held(AbstractController):
    """The same command always."""

    command: Float[Array, "2"]

    def start(self, observation):
        return ()

    def __call__(self, observation, memory, *, key):
        return self.command, ()


class Recited(AbstractController):
    """One command after the other; the memory is how many."""

    commands: Float[Array, "control 2"]

    def start(self, observation):
        return jnp.zeros((), int)

    def __call__(self, observation, memory, *, key):
        return self.commands[memory], memory + 1


def open_water(*, inert=False, environment=None, **changes):
    """A swimmer of speed 1 (or thrust 1 and drag 0.5) in a wide arena, far from a goal.

    Its thrust is its frequency.
    """
    environment = ZeroForce() if environment is None else environment
    dynamics = OverdampedSwimmer(ZeroForce(), environment, 1.0)
    if inert:
        dynamics = Swimmer(ZeroForce(), LinearDrag(DRAG), environment)
    settings = {
        "name": "open water",
        "truth": SteeredSwimmer(
            dynamics, RollingActuator(jnp.eye(2), LinearResponse())
        ),
        "start": jnp.zeros(4 if inert else 2),
        "objective": ReachGoal([50.0, 0.0], 0.5),
        "limits": CommandLimits(1.0),
        "arena": Rectangle([-100.0, -100.0], [100.0, 100.0]),
        "keep_out": (),
        "step": 0.1,
        "time_limit": 2.0,
    }
    return Task(**settings | changes)


AHEAD = Held(jnp.array([1.0, 0.0]))
ASIDE = Held(jnp.array([1.0, math.pi / 2]))


def without_noise(task):
    return eqx.tree_at(lambda t: (t.noise, t.sensor_noise), task, (0.0, 0.0))
