"""`pinav navigate --learn-online`: a task done without any data beforehand."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import msgspec
import numpy as np

from pinav.commands.cells import Row
from pinav.commands.fitted_run import FittedRun
from pinav.commands.navigate.metrics import ArrivalRow, IntervalRow
from pinav.commands.navigate.settings import NavigateSettings, OnlineSettings
from pinav.commands.steering import observe_positions, system_task
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.figures.style import DIMENSIONLESS, with_order, with_unit
from pinav.navigation import Disc, ReachGoal, Task, task
from pinav.navigation.adaptive.flight import Flight, fly
from pinav.navigation.adaptive.prior import with_prior_of
from pinav.navigation.adaptive.scores import (
    FlightRecord,
    Outcome,
    judge_flights,
    true_force,
)
from pinav.navigation.adaptive.steering import Adaptive
from pinav.navigation.adaptive.strategies import (
    AbstractStrategy,
    Certain,
    Curious,
    Doubted,
    Priced,
    Sampled,
)
from pinav.navigation.belief.belief import Belief
from pinav.report import Table, quantity
from pinav.report.text import as_text
from pinav.runs import RunFolder
from pinav.scenarios import find_system
from pinav.systems import Units

STRATEGIES: Mapping[str, AbstractStrategy] = {
    "certain": Certain(),
    "averse": Priced(1.0),
    "curious": Curious(),
    "doubted": Doubted(0.5),
    "sampled": Sampled(),
}
"""What `--strategy` names."""

MAP_POINTS = 41
"""Points of the maps of the force along each side."""

MOMENTS, MOMENTS_KEPT = 4, 40
"""Beliefs of the first flight that are shown, and those among which are chosen."""

ORACLE = "oracle"
"""The controller that knows the true force."""


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


@dataclasses.dataclass(frozen=True, eq=False)
class SwimmerFlights:
    """The flights of one swimmer.

    Attributes:
        records: by the controller: the oracle, and each visit.
        shown: arrays behind the figures of the first swimmer; empty for others.
    """

    records: Mapping[str, FlightRecord]
    shown: Mapping[str, np.ndarray]

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All of it, for a file."""
        flown = {
            f"flight/{name}/{field}": array
            for name, record in self.records.items()
            for field, array in record.arrays.items()
        }
        return flown | {f"shown/{name}": array for name, array in self.shown.items()}

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, np.ndarray]) -> "SwimmerFlights":
        """The flights that `arrays` came from."""
        flown: dict[str, dict[str, np.ndarray]] = {}
        shown: dict[str, np.ndarray] = {}
        for key, array in arrays.items():
            part, _, rest = key.partition("/")
            if part == "shown":
                shown[rest] = array
            else:
                name, _, field = rest.partition("/")
                flown.setdefault(name, {})[field] = array
        records = {name: FlightRecord.of_arrays(some) for name, some in flown.items()}
        return cls(records, shown)


def fly_swimmer(
    adaptive: Adaptive, seed: int, number: int, visits: int, *, oracle: bool = True
) -> SwimmerFlights:
    """The oracle's flight and those of each visit, with the same noise.

    Args:
        adaptive: the controller.
        seed: of all noise.
        number: of the swimmer; the first one is shown.
        visits: to the task, with the map kept.
        oracle: whether its flight is wanted.
    """
    problem, key = adaptive.task, jax.random.fold_in(jax.random.key(seed), number)
    records: dict[str, FlightRecord] = {}
    if oracle:
        known = fly(adaptive, key=key, oracle=True)
        records[ORACLE] = FlightRecord.of(known, problem)
    belief: Belief | None = None
    shown: dict[str, np.ndarray] = {}
    for visit in range(1, visits + 1):
        is_shown = number == 0 and visit == 1
        every = problem.time_limit / MOMENTS_KEPT if is_shown else math.inf
        flight = fly(adaptive, key=key, belief=belief, every=every)
        records[f"visit {visit}"] = FlightRecord.of(flight, problem)
        if is_shown:
            shown = _arrays_of_flight(problem, flight)
        belief = flight.belief
    return SwimmerFlights(records, shown)


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


def with_prior(adaptive: Adaptive, run: FittedRun, units: Units) -> Adaptive:
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
        adaptive = with_prior(adaptive, FittedRun.open(prior), units_of(online))
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


def _arrays_of_flight(problem: Task, first: Flight) -> dict[str, np.ndarray]:
    """What the figures show of the first flight, and of the task."""
    lower, upper = np.asarray(problem.arena.lower), np.asarray(problem.arena.upper)
    x, y = np.linspace(lower, upper, MAP_POINTS).T
    points = np.stack(np.meshgrid(x, y), axis=-1)
    flat, shape = points.reshape(-1, 2), points.shape
    goal = problem.objective
    assert isinstance(goal, ReachGoal)
    discs = [[*z.center, z.radius] for z in problem.keep_out if isinstance(z, Disc)]
    path = first.states[:, :2]
    mean, sd = first.belief.force(path)
    arrays = {
        "arena": np.array([lower, upper]),
        "start": np.asarray(problem.start[:2]),
        "goal": np.asarray(goal.goal),
        "tolerance": np.asarray(goal.tolerance),
        "discs": np.array(discs).reshape(-1, 3),
        "step": np.asarray(problem.step),
        "field/x": x,
        "field/y": y,
        "field/true": true_force(problem, flat).reshape(shape),
        "band/true": true_force(problem, path),
        "band/mean": mean,
        "band/sd": sd,
    }
    learned, spread = first.belief.force(flat)
    arrays["field/learned"] = learned.reshape(shape)
    arrays["field/sd"] = spread.reshape(shape)
    picked = np.linspace(0, len(first.moments) - 1, MOMENTS).round().astype(int)
    moments = [first.moments[k] for k in picked]
    arrays["moments/time"] = np.array([belief.time for belief in moments])
    for name, part in (("mean", 0), ("sd", 1)):
        maps = [belief.force(flat)[part].reshape(shape) for belief in moments]
        arrays[f"moments/{name}"] = np.stack(maps)
    return arrays


def online_table(
    controllers: Mapping[str, OnlineRow], units: Mapping[str, str] = DIMENSIONLESS
) -> Table:
    """One row for each controller.

    Args:
        controllers: rows by their names.
        units: of each channel; "1" means dimensionless.
    """
    length, time = units.get("x", "1"), units.get("t", "1")
    columns = {
        "success": lambda row: row.success.percent(),
        "in time": lambda row: row.in_time.percent(),
        "violation": lambda row: row.violation.percent(),
        with_unit("arrival", time): lambda row: row.arrival.median,
        "5 %": lambda row: row.arrival.low,
        "95 %": lambda row: row.arrival.high,
        "regret": lambda row: "–" if row.regret is None else row.regret.ratio(),
        with_unit("least clearance", length): lambda row: row.clearance,
        "force error": lambda row: "–" if row.force_error is None else row.force_error,
        "cover": lambda row: "–" if row.cover is None else row.cover,
        "consistency": lambda row: row.consistency,
    }
    rows = [
        (name, *(column(row) for column in columns.values()))
        for name, row in controllers.items()
    ]
    runs = next(iter(controllers.values())).runs
    return Table(("flights", *columns), rows, f"{runs} flights each. {CAPTION}")


CAPTION = (
    "Success, violation and arrival within the task's own limit (in time) with "
    "Wilson's 95 % interval; arrival: median and quantiles of those that arrived; "
    "regret: median over pairs of the arrival time over that with the true force; "
    "force error: root sum of squared errors over the visited path, relative; cover: "
    "of nominal 95 % bands there; consistency: squared error of the position over its "
    "variance, 1 where the filter is right."
)


def sentences(metrics: OnlineMetrics) -> list[str]:
    """The findings in words."""
    last = list(metrics.controllers.values())[1]
    length, time = (metrics.units.get(channel, "1") for channel in ("x", "t"))
    known = "the fit alone" if metrics.prior else "nothing"
    return [
        f"Task {metrics.task} (synthetic), strategy {metrics.strategy}: {known} is "
        f"known of the force beforehand; positions with an error of "
        f"{quantity(metrics.position_noise, length)} are all that is observed, "
        f"commands come into force after {quantity(metrics.delay, time)}.",
        f"Flights were given up after {quantity(metrics.time_limit, time)}; the "
        f"task's own limit is {quantity(metrics.own_limit, time)}.",
        f"Learning from a frame takes at most {1e3 * (last.frame_time or 0):.2g} ms "
        f"(99 %), a command {1e3 * (last.command_time or 0):.2g} ms, a plan "
        f"{1e3 * (last.replan_time or 0):.2g} ms (medians); the belief takes "
        f"{last.memory / 1e6:.2g} MB. The safety filter changed {last.changed:.2g} "
        "commands in a flight.",
    ]


def text(metrics: OnlineMetrics) -> str:
    """The findings for a terminal."""
    table = online_table(metrics.controllers, metrics.units)
    return "\n".join([as_text(table), *sentences(metrics)])
