"""`pinav navigate`: plan on a learned force, and try it in closed loop.

Closed loops and flights are cells of a sweep. Text goes in: the settings, and the
folders of runs that are read. Stored values come out.
"""

import dataclasses
import functools
import hashlib
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import msgspec

from pinav.commands import NAVIGATE
from pinav.commands.command import CommandResult
from pinav.commands.navigate import NavigateOptions, NavigateSettings, OnlineSettings
from pinav.commands.results import keep, open_fit, start_run
from pinav.commands.settings import ALONE
from pinav.commands.steering import observe_positions, system_task, way_of
from pinav.commands.sweep import FILE, Sweep, start_sweep
from pinav.dynamics import AbstractSwimmer
from pinav.errors import InputError
from pinav.learning.learned import Learned
from pinav.navigation import (
    TASKS,
    AbstractController,
    AdaptiveController,
    Attempt,
    Episodes,
    NavigationProblem,
    OnlineNavigation,
    SwimmerFlights,
    Task,
    compare_models,
    concatenate_episodes,
    episode_keys,
    fly_swimmer,
    task,
)
from pinav.navigation.adaptive.prior import with_prior_of
from pinav.runs import RunFolder
from pinav.scenarios import find_system
from pinav.sweeps import Cell
from pinav.systems import System, Units
from pinav.units import with_order


def run(options: NavigateOptions) -> CommandResult:
    """Navigate as the command line does."""
    settings, run = options.settings, options.run
    if run is None or options.online.learn_online is not None:
        return _learn_online(options)
    settings.places()  # before the run is read, which takes seconds
    problem = navigation_problem(settings, open_fit(run, steers=not options.anyway))
    compare = partial(compare_models, problem, seeds=settings.seeds, seed=settings.seed)
    if options.workers == ALONE:
        folder = start_run(NAVIGATE, options, settings, fitted=run.name)
        return keep(NAVIGATE, folder, compare())
    with start_sweep(
        NAVIGATE, options, options.workers, settings, fitted=run.name
    ) as sweep:
        found = compare(attempts=partial(sweep_loops, sweep, settings, run))
        return keep(NAVIGATE, sweep.folder, found)


def _learn_online(options: NavigateOptions) -> CommandResult:
    settings, learning, prior = options.settings, options.online, options.run
    problem = online_problem(settings, learning, prior)
    identity = {} if prior is None else {"prior": prior.name}
    with start_sweep(
        NAVIGATE, options, options.workers, settings, learning, **identity
    ) as sweep:
        found = OnlineNavigation.of(
            problem.adaptive,
            sweep_flights(sweep, settings, learning, prior),
            own_limit=problem.own_limit,
            units=problem.units,
        )
        return keep(NAVIGATE, sweep.folder, found)


def online_task(name: str, *, position_noise: float, delay: float | None) -> Task:
    """A task of the package as `observe_positions` has it.

    Args:
        position_noise: standard deviation of each coordinate [L].
    """
    known = task(name)
    delayed = known if delay is None else dataclasses.replace(known, delay=delay)
    return observe_positions(delayed, position_noise)


def system_to_learn(settings: NavigateSettings, name: str) -> System | None:
    """The system that the options name beside its places; none for a named task."""
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
    """The controller that begins with the force and the posterior of a fit."""
    if run.system.base_units != units:
        raise InputError(
            f"RUN: expected a fit in {_words(units)}, got one in "
            f"{_words(run.system.base_units)}; fit and task must have the same units"
        )
    model, path = run.model, run.folder.path
    if not isinstance(model, AbstractSwimmer):
        raise InputError(
            f"RUN: expected a fitted swimmer, got the model {run.choice.name} of {path}"
        )
    if run.posterior is None:
        raise InputError(
            f"RUN: expected a fit with a posterior, got {path}, which has none; "
            "fit with --recipe bayes"
        )
    return with_prior_of(adaptive, model, run.posterior, run.data.seen_positions)


def _words(units: Units) -> str:
    return f"{units.length}, {units.time} and {units.force}"


@dataclasses.dataclass(frozen=True, eq=False)
class OnlineProblem:
    """A task that is learned on the way.

    Attributes:
        own_limit: time limit of the task itself [T].
        units: units of the channels, and the order of the dynamics.
    """

    adaptive: AdaptiveController
    own_limit: float
    units: Mapping[str, str]


@functools.lru_cache(maxsize=1)
def online_problem(
    settings: NavigateSettings, online: OnlineSettings, prior: Path | None
) -> OnlineProblem:
    """The problem that the options ask for."""
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
        adaptive = with_prior(adaptive, open_fit(prior), units)
    channels = units.of_channels(("x", "y"))
    order = 2 if observed.inertial else 1
    return OnlineProblem(
        adaptive, known.time_limit, with_order(channels, order, units.force)
    )


LOOPS_OF_A_CELL = 10
"""Closed loops in a cell: fewer would take less time than the plan before them."""


@dataclasses.dataclass(frozen=True, eq=False)
class Loops:
    """The result of a cell of closed loops.

    Attributes:
        episodes: the loops; none where the model sees no way.
        refused: the reason then.
    """

    episodes: Episodes | None
    refused: str = ""


class LoopsCell(msgspec.Struct, frozen=True):
    """The settings of some closed loops with one model.

    Attributes:
        digest: digest of the files of the fit.
    """

    settings: NavigateSettings
    digest: str
    model: str
    first: int
    last: int


class FlightsCell(msgspec.Struct, frozen=True):
    """The settings of the flights of one swimmer that learns on the way.

    Attributes:
        prior: folder of the fit to begin with.
        digest: digest of its files, and of that of the system.
    """

    settings: NavigateSettings
    online: OnlineSettings
    digest: str
    prior: str | None = None


def navigation_problem(settings: NavigateSettings, run: Learned) -> NavigationProblem:
    """The navigation problem of a run, from its system and model alone."""
    way = way_of(settings, max(run.data.dim, 2))
    way = dataclasses.replace(way, sensor_noise=settings.sensor_noise)
    drawn = settings.samples if settings.samples > 1 else 0
    return NavigationProblem.of(run, way, samples=drawn, seed=settings.seed)


def sweep_loops(
    sweep: Sweep, settings: NavigateSettings, run: Path, models: Sequence[str]
) -> list[Attempt]:
    """Closed loops with several models, by the workers of a sweep."""
    digest = _digest(run)
    cells = {
        model: [
            Cell.of(
                "pinav.commands.navigate.job:do_loops",
                LoopsCell(settings, digest, model, first, last),
                system=str(run.absolute()),
                label=f"{model}, seeds {first} to {last}",
                shape=model,
            )
            for first, last in _parts(settings.seeds)
        ]
        for model in models
    }
    sweep.run([cell for some in cells.values() for cell in some], "closed loops")
    return [(model, _loops(sweep, some)) for model, some in cells.items()]


def _parts(seeds: int) -> list[tuple[int, int]]:
    firsts = range(0, seeds, LOOPS_OF_A_CELL)
    return [(first, min(first + LOOPS_OF_A_CELL, seeds) - 1) for first in firsts]


def _loops(sweep: Sweep, cells: Sequence[Cell]) -> Episodes | str:
    """The loops of several cells; the reason where a model sees no way."""
    parts = []
    for cell in cells:
        loops = sweep.result(cell, Loops)
        if loops.episodes is None:
            return loops.refused
        parts.append(loops.episodes)
    return concatenate_episodes(parts)


def do_loops(cell: Cell, folder: Path) -> None:
    """Do the closed loops of a cell."""
    one = cell.read(LoopsCell)
    settings = one.settings
    problem = _problem(cell.system, settings)
    try:
        steering = _steering(cell.system, settings, one.model)
    except InputError as error:
        loops = Loops(None, str(error))
    else:
        keys = episode_keys(settings.seed, settings.seeds)
        numbers = range(one.first, one.last + 1)
        loops = Loops(problem.attempt(steering, keys, numbers))
    RunFolder(folder).store(FILE, loops)


@functools.lru_cache(maxsize=1)
def _problem(run: str, settings: NavigateSettings) -> NavigationProblem:
    return navigation_problem(settings, Learned.open(Path(run)))


@functools.lru_cache(maxsize=3)
def _steering(run: str, settings: NavigateSettings, model: str) -> AbstractController:
    return _problem(run, settings).controller_with(model)


def sweep_flights(
    sweep: Sweep, settings: NavigateSettings, online: OnlineSettings, prior: Path | None
) -> list[SwimmerFlights]:
    """The flights of every swimmer, by the workers of a sweep."""
    system = Path(online.learn_online or "")
    if system.is_file():  # a worker may have another working directory
        online = msgspec.structs.replace(online, learn_online=str(system.absolute()))
    place = prior and str(prior.absolute())
    one = FlightsCell(settings, online, _digest(prior, system), place)
    cells = [
        Cell.of(
            "pinav.commands.navigate.job:do_flights",
            one,
            system=online.learn_online or "",
            seed=number,
            label=f"swimmer {number}",
        )
        for number in range(settings.seeds)
    ]
    sweep.run(cells, "swimmers")
    return [sweep.result(cell, SwimmerFlights) for cell in cells]


def do_flights(cell: Cell, folder: Path) -> None:
    """Do the flights of one swimmer."""
    one = cell.read(FlightsCell)
    prior = None if one.prior is None else Path(one.prior)
    adaptive = online_problem(one.settings, one.online, prior).adaptive
    flights = fly_swimmer(adaptive, one.settings.seed, cell.seed, one.online.visits)
    RunFolder(folder).store(FILE, flights)


OF_A_FIT = (
    *("", "model.eqx", "posterior.json", "posterior.npz", "data.npz", "system.toml"),
)
"""The file itself, and files of a run that a fit is made of."""


def _digest(*paths: Path | None) -> str:
    """Digest of files, and of everything that fits are made of."""
    digest = hashlib.sha256()
    for path in paths:
        for name in OF_A_FIT:
            if path is not None and (path / name).is_file():
                digest.update((path / name).read_bytes())
    return digest.hexdigest()[:16]
