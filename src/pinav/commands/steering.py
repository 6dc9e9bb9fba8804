"""A task, from settings of the command line and the system of a swimmer."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.actuation import AbstractActuator, LinearResponse, RollingActuator
from pinav.commands.steering_settings import SteeringSettings
from pinav.dynamics import OverdampedSwimmer, Swimmer, takes_commands, unbound
from pinav.errors import InputError
from pinav.evaluation import enclosing_cube
from pinav.forces import AbstractCommandedForce, WallMobility, ZeroForce
from pinav.navigation import (
    Behind,
    CommandLimits,
    Disc,
    ReachGoal,
    Rectangle,
    SteeredSwimmer,
    Task,
)
from pinav.systems import System
from pinav.trajectories import Trajectories


def system_task(settings: SteeringSettings, system: System) -> Task:
    """The task of going through the true environment of a system, without data.

    Raises:
        InputError: the system is not planar or states no true environment.
    """
    _check_planar(settings, system)
    truth = system.true_swimmer
    return task_of(settings, truth, truth, np.zeros((0, 2)), system.name)


def known_task(settings: SteeringSettings, system: System, data: Trajectories) -> Task:
    """The same in a system of which nothing more than data are known.

    The truth of the task is the known physics; the arena surrounds the data, too.

    Raises:
        InputError: the system or the data are not planar.
    """
    _check_planar(settings, system)
    if data.dim != 2:
        raise InputError(
            f"--data: expected positions in the plane, got {', '.join(data.channels)}"
        )
    corners = np.array(enclosing_cube(data))
    swimmer = system.swimmer.with_environment(ZeroForce())
    return task_of(settings, swimmer, swimmer, corners, system.name)


def observe_positions(known: Task, position_noise: float) -> Task:
    """A task whose positions alone are observed, with an error.

    With inertia the time limit is doubled, so that a slow arrival is a regret and not a
    failure.

    Args:
        known: the task.
        position_noise: standard deviation of each coordinate [L].
    """
    return dataclasses.replace(
        known,
        sensor_noise=position_noise,
        time_limit=known.time_limit * (2 if len(known.start) == 4 else 1),
    )


def _check_planar(settings: SteeringSettings, system: System) -> None:
    if system.dim != 2:
        raise InputError(
            f"system: expected a swimmer in the plane, got {system.name!r}, which has "
            f"{system.dim} dimensions; state a system with dimension = 2"
        )
    settings.check_dimension(2)


def task_of(
    settings: SteeringSettings,
    model: Swimmer | OverdampedSwimmer,
    truth: Swimmer | OverdampedSwimmer,
    places: Float[np.ndarray, "place dim"],
    name: str,
) -> Task:
    """The task of going from a place to a place.

    The actuator is the propulsion of the model where that takes frequency and heading;
    a swimmer whose thrust cannot be steered gets one that can, of the size that the
    settings state. The wall of a mobility must not be touched.

    Args:
        settings: settings of the command line.
        model: whose propulsion is steered.
        truth: the true swimmer.
        places: which the arena surrounds beside start and goal [L].
        name: name of the task.
    """
    start, goal = settings.places()
    actuator, limits, lag = _actuation(settings, model)
    rest = [0.0] * len(start) if isinstance(truth, Swimmer) else []
    return Task(
        name=name,
        truth=SteeredSwimmer(truth, actuator),
        start=jnp.asarray([*start, *rest]),
        objective=ReachGoal(list(goal), settings.tolerance),
        limits=limits,
        arena=_arena(settings, places),
        keep_out=(
            *(Disc(list(d[:-1]), d[-1]) for d in settings.discs()),
            *_walls(model),
        ),
        step=settings.step,
        time_limit=settings.time_limit,
        noise=settings.noise,
        delay=lag if settings.delay is None else settings.delay,
    )


def _walls(model: Swimmer | OverdampedSwimmer) -> tuple[Behind, ...]:
    """The wall that the mobility knows, which the swimmer's surface must not touch."""
    mobility = getattr(model, "mobility", None)
    if not isinstance(mobility, WallMobility):
        return ()
    return (Behind(mobility.wall, mobility.radius),)


def _actuation(
    settings: SteeringSettings, model: Swimmer | OverdampedSwimmer
) -> tuple[AbstractActuator, CommandLimits, float]:
    """The effect of commands, their limits, and the time from command to motion [T]."""
    propulsion = unbound(model) if takes_commands(model) else model.propulsion
    if not isinstance(propulsion, AbstractCommandedForce):
        gain = settings.thrust * jnp.eye(len(settings.places()[0]))
        return RollingActuator(gain, LinearResponse()), CommandLimits(1.0), 0.0
    limits = CommandLimits(settings.frequency)
    return propulsion.actuator, limits, propulsion.lateness


def _arena(
    settings: SteeringSettings, places: Float[np.ndarray, "place dim"]
) -> Rectangle:
    """The arena that was given, or one around start, goal and further places [L]."""
    box = settings.box()
    if box is not None:
        return Rectangle(*map(list, (box[: len(box) // 2], box[len(box) // 2 :])))
    ends = np.array(settings.places())
    margin = 0.25 * float(np.linalg.norm(ends[1] - ends[0])) + settings.tolerance
    inside = np.concatenate([ends - margin, ends + margin, places])
    return Rectangle(inside.min(axis=0), inside.max(axis=0))
