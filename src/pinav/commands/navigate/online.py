"""`pinav navigate --learn-online`: a task done without any data beforehand."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pinav.commands.navigate import NavigateSettings, OnlineSettings
from pinav.commands.steering import observe_positions, system_task
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.learning.learned import Learned
from pinav.navigation import TASKS, AdaptiveController, Task, task
from pinav.navigation.adaptive.prior import with_prior_of
from pinav.scenarios import find_system
from pinav.systems import System, Units
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


def system_to_learn(settings: NavigateSettings, name: str) -> System | None:
    """The system that the options name beside its places; none for a named task.

    Raises:
        InputError: the system is unknown, or there is neither a task nor a place.
    """
    if settings.start is None and settings.goal is None:
        if name not in TASKS:
            raise InputError(
                f"--learn-online: task {name!r} is unknown; choose one of: "
                f"{', '.join(TASKS)}; or state a system, with --from and --to"
            )
        return None
    return find_system(name)


def with_prior(
    adaptive: AdaptiveController, run: Learned, units: Units
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
            f"RUN: expected a fit in {_words(units)}, got one in "
            f"{_words(run.system.base_units)}; fit and task must have the same units"
        )
    model, path = run.model, run.folder.path
    if not isinstance(model, Swimmer | OverdampedSwimmer):
        raise InputError(
            f"RUN: expected a fitted swimmer, got the model {run.choice.name} of {path}"
        )
    if run.posterior is None:
        raise InputError(
            f"RUN: expected a fit with a posterior, got {path}, which has none; "
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
        units: units of the channels, and the order of the dynamics.
    """

    adaptive: AdaptiveController
    own_limit: float
    units: Mapping[str, str]


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
    name = online.learn_online or ""
    system = system_to_learn(settings, name)
    if system is not None:
        known, units = system_task(settings, system), system.base_units
        observed = observe_positions(known, online.position_noise)
    else:  # the package's tasks have no units
        known, units = task(name), Units()
        observed = online_task(
            name, position_noise=online.position_noise, delay=settings.delay
        )
    adaptive = AdaptiveController.of(observed)
    if prior is not None:
        adaptive = with_prior(adaptive, Learned.open(prior), units)
    channels = units.of_channels(("x", "y"))
    order = 2 if observed.inertial else 1
    return OnlineProblem(
        adaptive, known.time_limit, with_order(channels, order, units.force)
    )
