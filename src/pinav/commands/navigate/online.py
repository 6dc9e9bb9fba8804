"""`pinav navigate --learn-online`: a task done without any data beforehand."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pinav.commands.fitted_run import FittedRun
from pinav.commands.navigate.settings import NavigateSettings, OnlineSettings
from pinav.commands.steering import observe_positions, system_task
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.navigation import (
    AdaptiveController,
    Course,
    OnlineNavigation,
    SwimmerFlights,
    Task,
    judge_controllers,
    task,
)
from pinav.navigation.adaptive.prior import with_prior_of
from pinav.scenarios import find_system
from pinav.systems import Units
from pinav.units import with_order


def online_task(name: str, *, position_noise: float, delay: float | None) -> Task:
    """A task of the package as `observe_positions` has it.

    Args:
        name: name of the task.
        position_noise: standard deviation of each coordinate [L].
        delay: from command to thrust [T]; that of the task for None.

    Raises:
        InputError: no task has that name.
    """
    known = task(name)
    delayed = known if delay is None else dataclasses.replace(known, delay=delay)
    return observe_positions(delayed, position_noise)


def task_to_learn(settings: NavigateSettings, online: OnlineSettings) -> Task:
    """The task that the options ask for, before its observation is changed.

    Raises:
        InputError: the task or the system is unknown, or the system cannot be steered
            through.
    """
    if online.system is not None:
        return system_task(settings, find_system(online.system))
    known = task(online.task or "")
    if settings.delay is None:
        return known
    return dataclasses.replace(known, delay=settings.delay)


def units_of(online: OnlineSettings) -> Units:
    """Units of the places and forces of the task; the package's tasks have none."""
    return Units() if online.system is None else find_system(online.system).base_units


def channel_units(
    online: OnlineSettings, adaptive: AdaptiveController
) -> Mapping[str, str]:
    """Units of the channels of the task, and the order of its dynamics."""
    units = units_of(online)
    order = 2 if adaptive.task.inertial else 1
    return with_order(units.of_channels(("x", "y")), order, units.force)


def with_prior(
    adaptive: AdaptiveController, run: FittedRun, units: Units
) -> AdaptiveController:
    """The controller that begins with the force and the posterior of a fit.

    Args:
        adaptive: the controller.
        run: the fit.
        units: units of the controller's task.

    Raises:
        InputError: the run holds no fitted swimmer, no posterior, one in other units,
            or one that does not move as that of the task does.
    """
    if run.system.base_units != units:
        raise InputError(
            f"--prior: expected a fit in {_words(units)}, got one in "
            f"{_words(run.system.base_units)}; fit and task must have the same units"
        )
    model, path = run.model, run.folder.path
    if not isinstance(model, Swimmer | OverdampedSwimmer):
        raise InputError(
            f"--prior: expected a fitted swimmer, got the model {run.choice.name} of "
            f"{path}"
        )
    if run.posterior is None:
        raise InputError(
            f"--prior: expected a fit with a posterior, got {path}, which has none; "
            "fit with --recipe bayes"
        )
    dim = run.data.dim
    places = [p.states[p.observed[:, :dim].all(axis=1), :dim] for p in run.data]
    return with_prior_of(adaptive, model, run.posterior, np.concatenate(places))


def _words(units: Units) -> str:
    return f"{units.length}, {units.time} and {units.force}"


@dataclasses.dataclass(frozen=True, eq=False)
class OnlineProblem:
    """A task that is learned on the way.

    Attributes:
        adaptive: the controller, with the task.
        own_limit: time limit of the task itself [T].
    """

    adaptive: AdaptiveController
    own_limit: float


def online_problem(
    settings: NavigateSettings, online: OnlineSettings, prior: Path | None
) -> OnlineProblem:
    """The problem that the options ask for.

    Args:
        settings: settings of the command.
        online: settings of learning.
        prior: folder of the fit to begin with; none to know nothing.

    Raises:
        InputError: the task or the system is unknown, or the system cannot be steered
            through, or the fit does not suit it.
    """
    known = task_to_learn(settings, online)
    observed = observe_positions(known, online.position_noise)
    adaptive = AdaptiveController.of(observed)
    if prior is not None:
        adaptive = with_prior(adaptive, FittedRun.open(prior), units_of(online))
    return OnlineProblem(adaptive, known.time_limit)


def judge_swimmers(
    problem: OnlineProblem,
    online: OnlineSettings,
    swimmers: Sequence[SwimmerFlights],
    *,
    prior: bool,
) -> OnlineNavigation:
    """The result of the flights of all swimmers.

    Args:
        problem: the task.
        online: settings of learning.
        swimmers: the first one with what is shown.
        prior: True where the first visit began with a fit.
    """
    adaptive, flown, shown = problem.adaptive, problem.adaptive.task, swimmers[0].shown
    assert shown is not None
    flights = {
        name: [one.flights[name] for one in swimmers] for name in swimmers[0].flights
    }
    return OnlineNavigation(
        task=flown.name,
        position_noise=online.position_noise,
        delay=flown.delay,
        time_limit=flown.time_limit,
        own_limit=problem.own_limit,
        thrust=adaptive.thrust,
        step=flown.step,
        prior=prior,
        units=dict(channel_units(online, adaptive)),
        course=Course.of(flown),
        controllers=judge_controllers(flights, problem.own_limit),
        paths={
            name: tuple(flight.path for flight in some)
            for name, some in flights.items()
        },
        shown=shown,
    )
