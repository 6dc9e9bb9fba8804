"""`pinav navigate --learn-online`: a task done without any data beforehand."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np

from pinav.commands.cells import Row
from pinav.commands.navigate.flights import ORACLE, SwimmerFlights
from pinav.commands.navigate.metrics import ArrivalRow, IntervalRow
from pinav.commands.navigate.settings import NavigateSettings, OnlineSettings
from pinav.commands.steering import observe_positions, system_task
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.learning.learned import Learned
from pinav.navigation import Task, task
from pinav.navigation.adaptive.prior import with_prior_of
from pinav.navigation.adaptive.scores import FlightRecord, Outcome, judge_flights
from pinav.navigation.adaptive.steering import Adaptive
from pinav.navigation.adaptive.strategies import (
    AbstractStrategy,
    Certain,
    Curious,
    Doubted,
    Priced,
    Sampled,
)
from pinav.runs import RunFolder
from pinav.scenarios import find_system
from pinav.systems import Units
from pinav.units import with_order

STRATEGIES: Mapping[str, AbstractStrategy] = {
    "certain": Certain(),
    "averse": Priced(1.0),
    "curious": Curious(),
    "doubted": Doubted(0.5),
    "sampled": Sampled(),
}
"""What `--strategy` names."""


class OnlineRow(Row, frozen=True):
    """Flights of one controller; see `Outcome`, whose fields these are.

    Attributes:
        runs: number of flights.
        success: proportion that arrived without a violation.
        in_time: proportion that arrived within the task's own time limit.
        violation: proportion that entered a forbidden place.
        arrival: times of those that arrived.
        regret: arrival time over that of the oracle; none for the oracle.
        clearance: least distance from forbidden places [L].
        force_error: of the force over the visited path, relative.
        cover: fraction of true forces within their bands of 95 %.
        consistency: squared error of the position over its variance.
        changed: commands that the safety filter changed, in a flight.
        frame_time: of learning from a frame, 99 % quantile [s].
        command_time: of a command, median [s].
        replan_time: of a plan, median [s].
        memory: of a belief at the end [byte].
    """

    runs: int
    success: IntervalRow
    in_time: IntervalRow
    violation: IntervalRow
    arrival: ArrivalRow
    regret: IntervalRow | None
    clearance: float
    force_error: float | None
    cover: float | None
    consistency: float | None
    changed: float
    frame_time: float | None
    command_time: float | None
    replan_time: float | None
    memory: float

    @classmethod
    def of_outcome(cls, outcome: Outcome) -> "OnlineRow":
        """The row of an outcome."""
        names = ArrivalRow.__struct_fields__
        arrival = dict(zip(names, outcome.arrival, strict=True))
        return cls.of(outcome, arrival=arrival)


class OnlineMetrics(msgspec.Struct, frozen=True):
    """The numbers of a task that was learned on the way.

    Attributes:
        task: its name.
        strategy: what the plan made of what is not known.
        position_noise: standard deviation of the observed positions [L].
        delay: from command to thrust [T].
        time_limit: when a flight was given up [T].
        own_limit: time limit of the task itself [T].
        thrust: greatest thrust.
        controllers: the oracle, and the visits.
        prior: whether the first visit began with a fit.
        units: of each channel, with the order of the dynamics; none of a task of the
            package.
    """

    task: str
    strategy: str
    position_noise: float
    delay: float
    time_limit: float
    own_limit: float
    thrust: float
    controllers: dict[str, OnlineRow]
    prior: bool = False
    units: dict[str, str] = {}


def online_task(name: str, *, position_noise: float, delay: float | None) -> Task:
    """A task of the package as `observe_positions` has it.

    Args:
        name: of the task.
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


def channel_units(online: OnlineSettings, adaptive: Adaptive) -> Mapping[str, str]:
    """Units of the channels of the task, and the order of its dynamics."""
    units = units_of(online)
    order = 2 if adaptive.task.inertial else 1
    return with_order(units.of_channels(("x", "y")), order, units.force)


def with_prior(adaptive: Adaptive, run: Learned, units: Units) -> Adaptive:
    """The controller that begins with the force and the posterior of a fit.

    Args:
        adaptive: the controller.
        run: the fit.
        units: of the controller's task.

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

    adaptive: Adaptive
    own_limit: float


def online_problem(
    settings: NavigateSettings, online: OnlineSettings, prior: Path | None
) -> OnlineProblem:
    """The problem that the options ask for.

    Args:
        settings: of the command.
        online: of learning.
        prior: folder of the fit to begin with; none to know nothing.

    Raises:
        InputError: the task or the system is unknown, or the system cannot be steered
            through, or the fit does not suit it.
    """
    known = task_to_learn(settings, online)
    observed = observe_positions(known, online.position_noise)
    adaptive = Adaptive.of(observed, STRATEGIES[online.strategy])
    if prior is not None:
        adaptive = with_prior(adaptive, Learned.open(prior), units_of(online))
    return OnlineProblem(adaptive, known.time_limit)


def write_online(
    problem: OnlineProblem,
    online: OnlineSettings,
    swimmers: Sequence[SwimmerFlights],
    folder: RunFolder,
) -> OnlineMetrics:
    """Judge the flights of all swimmers, and write the results.

    Args:
        problem: the task.
        online: of learning.
        swimmers: the first one with what is shown.
        folder: of the run.
    """
    adaptive, flown = problem.adaptive, problem.adaptive.task
    flights = {
        name: [one.records[name] for one in swimmers] for name in swimmers[0].records
    }
    metrics = OnlineMetrics(
        task=flown.name,
        strategy=online.strategy,
        position_noise=online.position_noise,
        delay=flown.delay,
        time_limit=flown.time_limit,
        own_limit=problem.own_limit,
        thrust=adaptive.thrust,
        controllers=rows_of(flights, problem.own_limit),
        prior=adaptive.prior is not None,
        units=dict(channel_units(online, adaptive)),
    )
    paths = {
        f"path/{name}/{index}": record.path
        for name, some in flights.items()
        for index, record in enumerate(some)
    }
    folder.write_arrays("results.npz", dict(swimmers[0].shown) | paths)
    folder.write_metrics("metrics.json", metrics)
    return metrics


def rows_of(
    flights: Mapping[str, Sequence[FlightRecord]], own_limit: float
) -> dict[str, OnlineRow]:
    """The outcome of each controller.

    Args:
        flights: the oracle's and others.
        own_limit: time limit of the task itself [T].
    """
    oracle = flights[ORACLE]
    return {
        name: OnlineRow.of_outcome(
            judge_flights(some, own_limit, oracle if name != ORACLE else ())
        )
        for name, some in flights.items()
    }
