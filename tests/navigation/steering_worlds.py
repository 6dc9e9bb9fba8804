"""Small tasks with closed forms, and controllers that do what they are told."""

import dataclasses
import functools
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.actuation import LinearResponse
from pinav.dynamics import RK4, FixedStep, OverdampedSwimmer, Swimmer
from pinav.forces import LinearDrag, UniformFlow, ZeroForce
from pinav.navigation import task
from pinav.navigation.belief.belief import Belief, Frame
from pinav.navigation.control.controller import AbstractController
from pinav.navigation.planning.plan import time_to_go
from pinav.navigation.predictors import AbstractPredictor, tabulate_model
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


def rolling(dynamics, dim=2):
    """A swimmer whose thrust is its frequency."""
    return SteeredSwimmer(dynamics, RollingActuator(jnp.eye(dim), LinearResponse()))


def open_water(*, inert=False, environment=None, drift=(0.0, 0.0), **changes):
    """A swimmer of speed 1 (or thrust 1 and drag 0.5) in a wide arena, far from a goal.

    Its thrust is its frequency. The drift has as many components as space.
    """
    environment = ZeroForce() if environment is None else environment
    dynamics = OverdampedSwimmer(ZeroForce(), environment, 1.0, UniformFlow(drift))
    if inert:
        dynamics = Swimmer(ZeroForce(), LinearDrag(DRAG), environment)
    settings = {
        "name": "open water",
        "truth": rolling(dynamics, len(drift)),
        "start": jnp.zeros(4 if inert else 2),
        "objective": ReachGoal([50.0, 0.0], 0.5),
        "limits": CommandLimits(1.0),
        "arena": Rectangle([-100.0, -100.0], [100.0, 100.0]),
        "keep_out": (),
        "step": 0.1,
        "time_limit": 2.0,
    }
    settings |= changes
    return Task(**settings | {"start": jnp.asarray(settings["start"])})


START = {2: np.array([-2.0, -1.0]), 3: np.array([-1.5, -1.0, -0.5])}
GOAL = {2: np.array([2.5, 1.5]), 3: np.array([1.5, 1.0, 0.5])}
TOLERANCE = {2: 0.2, 3: 0.25}
"""Of the tasks in a small square, or cube, of water."""


def swimming(drift=(0.0, 0.0), **changes):
    """From a place to a place at speed 1 in a small square, or cube, of water."""
    dim = len(drift)
    half, limit = {2: (4.0, 20.0), 3: (2.5, 15.0)}[dim]
    options = {
        "start": START[dim],
        "objective": ReachGoal(GOAL[dim], TOLERANCE[dim]),
        "arena": Rectangle([-half] * dim, [half] * dim),
        "time_limit": limit,
    }
    return open_water(drift=drift, **options | changes)


def planned(task, **settings):
    """The time to go of a task by what is true in it."""
    points = {2: 41, 3: 9}[task.dim]
    tables = tabulate_model(task, task.truth, margin=0.01, points=points)
    return time_to_go(task, task.truth, tables=tables, **settings)


def drifted_time(way, drift, tolerance):
    """Time over a way at speed 1: |way - w T| = T + tolerance, its first root."""
    way, w = np.asarray(way), np.asarray(drift)
    a, b, c = w @ w - 1, -(way @ w) - tolerance, way @ way - tolerance**2
    return min(r.real for r in np.roots([a, 2 * b, c]) if abs(r.imag) < 1e-12 < r.real)


def vortex(dynamics=None, **changes):
    """The task of the vortex, or of another swimmer in it, seen with an error."""
    known = dataclasses.replace(task("vortex"), sensor_noise=0.02)
    if dynamics is not None:
        rest = jnp.zeros(2 if isinstance(dynamics, Swimmer) else 0)
        changes |= {
            "truth": SteeredSwimmer(dynamics, known.truth.actuator),
            "start": jnp.concatenate([known.start[:2], rest]),
        }
    return dataclasses.replace(known, **changes)


def frame_at(x, y, time=0.0, thrust=(0.0, 0.0)):
    return Frame(time, np.array([x, y]), 0.02, np.array(thrust))


def learned(belief, frames):
    """The belief after some frames."""
    return functools.reduce(Belief.after, frames, belief)


AHEAD = Held(jnp.array([1.0, 0.0]))
ASIDE = Held(jnp.array([1.0, math.pi / 2]))


def without_noise(task):
    return eqx.tree_at(lambda t: (t.noise, t.sensor_noise), task, (0.0, 0.0))
