"""A task, from settings of the command line and the system of a swimmer."""

import dataclasses

import numpy as np

from pinav.commands.settings import numbers
from pinav.commands.steering_settings import SteeringSettings
from pinav.errors import InputError
from pinav.evaluation import enclosing_cube
from pinav.navigation import Suggestion, Task, Way
from pinav.report import Table
from pinav.systems import System
from pinav.trajectories import Trajectories


def system_task(
    settings: SteeringSettings, system: System, data: Trajectories | None = None
) -> Task:
    """The task of going through the true environment of a system.

    Where there are data nothing else is known of that: the truth of the task is the
    known physics, and the arena surrounds the data, too.
    """
    if system.dim != 2:
        raise InputError(
            f"system: expected a swimmer in the plane, got {system.name!r}, which has "
            f"{system.dim} dimensions; state a system with dimension = 2"
        )
    way = way_of(settings, 2)
    if data is None:
        truth = system.true_swimmer
        return way.task(truth, truth, system.name)
    if data.dim != 2:
        raise InputError(
            f"--data: expected positions in the plane, got {', '.join(data.channels)}"
        )
    corners = np.array(enclosing_cube(data))
    known = system.swimmer.without_environment()
    return way.task(known, known, system.name, corners)


def observe_positions(known: Task, position_noise: float) -> Task:
    """A task whose positions alone are observed, with an error.

    With inertia the time limit is doubled, so that a slow arrival is a regret and not a
    failure.

    Args:
        position_noise: standard deviation of each coordinate [L].
    """
    return dataclasses.replace(
        known,
        sensor_noise=position_noise,
        time_limit=known.time_limit * (2 if len(known.start) == 4 else 1),
    )


def programme_table(suggestion: Suggestion, caption: str, name: str) -> Table:
    """The commands of a trajectory to record next, and the file that holds them."""
    series = suggestion.times, suggestion.frequency, suggestion.heading
    rows = list(zip(*(values.tolist() for values in series), strict=True))
    return Table(("t", "frequency", "heading"), rows, caption, name)


def way_of(settings: SteeringSettings, dim: int) -> Way:
    """The way that the options state.

    Raises:
        InputError: a place has not as many coordinates as the swimmer.
    """
    settings.places()
    box, start, goal = settings.arena, settings.start or "", settings.goal or ""
    corners = None if box is None else numbers("--arena", box, 2 * dim)
    discs = (numbers("--keep-out", text, dim + 1) for text in settings.keep_out)
    return Way(
        numbers("--from", start, dim),
        numbers("--to", goal, dim),
        tolerance=settings.tolerance,
        thrust=settings.thrust,
        keep_out=tuple(discs),
        arena=None if corners is None else (corners[:dim], corners[dim:]),
        step=settings.step,
        time_limit=settings.time_limit,
        noise=settings.noise,
        delay=settings.delay,
        frequency=settings.frequency,
    )
