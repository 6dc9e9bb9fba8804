"""Plans with a learned model, tried in closed loop beside others, and results."""

import dataclasses
import operator
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import jax
import numpy as np
from jaxtyping import Float

from pinav.errors import InputError
from pinav.evaluation import FieldMap, distances
from pinav.fitting import AbstractLearned
from pinav.forces import forces_at
from pinav.learning.findings import ForceMaps
from pinav.navigation.adaptive.flight import (
    ORACLE,
    FlightOutcome,
    ShownFlight,
    SwimmerFlights,
    judge_controllers,
)
from pinav.navigation.adaptive.steering import AdaptiveController
from pinav.navigation.control.controller import AbstractController
from pinav.navigation.design.candidates import Suggestion
from pinav.navigation.planning.plan import Route, TimeToGo
from pinav.navigation.problem import (
    LEARNED,
    NavigationProblem,
    episode_keys,
    suggest_trajectory,
)
from pinav.navigation.task.catalogue import Way
from pinav.navigation.task.steering import SteeredSwimmer
from pinav.navigation.task.task import Course, Task
from pinav.navigation.trials.closed_loop import Episodes, run
from pinav.navigation.trials.metrics import Interval, Summary, regret, summary
from pinav.threads import map_on_cores

MAP_POINTS = 61
"""Points of the maps along each side."""

LATTICE_HEADINGS = 24
"""Directions of the thrust that go with the lattice of a plan."""

Attempt = tuple[str, Episodes | str]
"""Name of a model, and closed loops with it, or why it sees no way."""


class AbstractNavigation:
    """The result of a navigation."""


@dataclasses.dataclass(frozen=True, eq=False)
class PlanLattice:
    """The values of a plan, as they can be evaluated elsewhere.

    Attributes:
        values: fraction that is left of a time to go, on a lattice of velocities, where
            there is inertia, and positions.
        lower: first point of the lattice along each axis.
        scale: time in which a value falls to 1/e [T].
        ahead: time that the control looks ahead [T].
        horizon: time limit of the task [T].
    """

    values: Float[np.ndarray, "..."]
    lower: Float[np.ndarray, " axis"]
    spacing: Float[np.ndarray, " axis"]
    scale: float
    ahead: float
    horizon: float
    thrusts: Float[np.ndarray, "heading 2"]


@dataclasses.dataclass(frozen=True, eq=False)
class PlannedWay:
    """The plan on the learned force.

    Attributes:
        time: from the start, at rest, to the goal [T].
        route_time: the same along the planned route [T]; infinite if it does not
            arrive.
        unreachable: fraction of the arena from which the goal cannot be reached.
        times: time to go from rest on the arena [T]; infinite where there is no way.
    """

    time: float
    route_time: float
    unreachable: float
    route: Float[np.ndarray, "time dim"]
    times: Float[np.ndarray, "..."]
    lattice: PlanLattice | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class ComputingTimes:
    """Computing time of the first command, with its compilation, and of others [s]."""

    first: float
    median: float


@dataclasses.dataclass(frozen=True, eq=False)
class Navigation(AbstractNavigation):
    """Plans with a learned model, and with others, tried in closed loop.

    Attributes:
        truth: name of the system whose environment is the truth; none if not known.
        controllers: performance, by the model with which they plan.
        regret: arrival times over those with the truth, by the same.
        units: units of the channels, and the order of the dynamics.
        delay: time from command to motion [T].
        step: time for which a command holds [T].
        maps: forces on the arena; none in space.
        suggestion: trajectory to record next; none where the fit tells of none.
    """

    truth: str | None
    plan: PlannedWay
    controllers: dict[str, Summary]
    regret: dict[str, Interval]
    refused: dict[str, str]
    computing: ComputingTimes
    units: dict[str, str]
    thrust: float
    delay: float
    step: float
    course: Course
    episodes: dict[str, Episodes]
    maps: ForceMaps | None = None
    suggestion: Suggestion | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class OnlineNavigation(AbstractNavigation):
    """Flights of swimmers that learn a force on the way.

    Attributes:
        position_noise: standard deviation of the observed positions [L].
        delay: time from command to thrust [T].
        time_limit: time when a flight is given up [T].
        own_limit: time limit of the task itself [T].
        step: time between two frames [T].
        prior: True where the first visit began with a fit.
        units: units of the channels, and the order of the dynamics.
        paths: true positions of each swimmer at the frames, by the controller [L].
        shown: first flight of the first swimmer.
    """

    task: str
    position_noise: float
    delay: float
    time_limit: float
    own_limit: float
    thrust: float
    step: float
    prior: bool
    units: dict[str, str]
    course: Course
    controllers: dict[str, FlightOutcome]
    paths: dict[str, tuple[Float[np.ndarray, "_ 2"], ...]]
    shown: ShownFlight

    @classmethod
    def of(
        cls,
        adaptive: AdaptiveController,
        swimmers: Sequence[SwimmerFlights],
        *,
        own_limit: float,
        units: Mapping[str, str],
    ) -> "OnlineNavigation":
        """The result of the flights of some swimmers."""
        task, shown = adaptive.task, swimmers[0].shown
        assert shown is not None
        flights = {
            name: [one.flights[name] for one in swimmers]
            for name in swimmers[0].flights
        }
        return cls(
            task=task.name,
            position_noise=task.sensor_noise,
            delay=task.delay,
            time_limit=task.time_limit,
            own_limit=own_limit,
            thrust=adaptive.thrust,
            step=task.step,
            prior=adaptive.known is not None,
            units=dict(units),
            course=Course.of(task),
            controllers=judge_controllers(flights, own_limit),
            paths={
                name: tuple(flight.path for flight in some)
                for name, some in flights.items()
            },
            shown=shown,
        )


def navigate(
    fit: AbstractLearned, way: Way, *, samples: int = 8, seeds: int = 20, seed: int = 0
) -> Navigation:
    """Go a way through the force that a fit has learned.

    Args:
        samples: models drawn from the posterior, whose spread makes uncertain regions
            cost more; 0 takes the model for true.
        seeds: closed loops with each model, each with its own noise.

    Raises:
        InputError: the fit is not of a swimmer in the plane or in space, or the goal
            cannot be reached.
    """
    problem = NavigationProblem.of(fit, way, samples=samples, seed=seed)
    return compare_models(problem, seeds=seeds, seed=seed)


def compare_models(
    problem: NavigationProblem,
    *,
    seeds: int = 20,
    seed: int = 0,
    attempts: Callable[[Sequence[str]], list[Attempt]] | None = None,
) -> Navigation:
    """Plan on a learned force, and try the plan in closed loop.

    Physics alone and, where it is known, the truth are tried beside the learned model.

    Args:
        seeds: closed loops with each model, each with its own noise.
        attempts: takes the names of models and tries them elsewhere; here unless given.

    Raises:
        InputError: start or goal are in a wall or outside the arena, or the goal
            cannot be reached with this thrust, as far as the model knows.
    """
    task = problem.task
    steered = problem.controller_with(LEARNED)
    plan = plan_of(steered)
    route = plan.route(task.start, task.step)
    way = _positions(task, route)

    def suggest() -> Suggestion | None:
        is_steady = len(plan.tables.table.values) == 1
        return suggest_trajectory(problem, way, seed=seed) if is_steady else None

    if attempts is not None:
        tried, suggestion = attempts(problem.models), suggest()
    else:
        # The first loops compile what the others need, while these are planned.
        _, *others = problem.models
        jobs = [
            partial(try_model, problem, LEARNED, seeds, seed, steered),
            *(partial(try_model, problem, name, seeds, seed) for name in others),
        ]
        jobs = [*jobs, suggest]
        *tried, suggestion = map_on_cores(operator.call, jobs, title="loops")
    episodes = {name: loops for name, loops in tried if isinstance(loops, Episodes)}
    compute = run(task, steered, key=jax.random.key(seed)).compute
    return Navigation(
        truth=problem.truth,
        plan=_planned_way(plan, route, way),
        controllers={name: summary(loops, task) for name, loops in episodes.items()},
        regret=_regrets(episodes),
        refused={name: reason for name, reason in tried if isinstance(reason, str)},
        computing=ComputingTimes(float(compute[0]), float(np.median(compute[1:]))),
        units=dict(problem.fit.units),
        thrust=problem.thrust,
        delay=task.delay,
        step=task.step,
        course=Course.of(task),
        episodes=episodes,
        maps=_maps(problem) if task.dim == 2 else None,
        suggestion=suggestion,
    )


def try_model(
    problem: NavigationProblem,
    name: str,
    seeds: int,
    seed: int,
    steering: AbstractController | None = None,
) -> Attempt:
    """All closed loops with a model; one that sees no way is an answer, too."""
    try:
        steering = problem.controller_with(name) if steering is None else steering
    except InputError as error:
        return name, str(error)
    return name, problem.attempt(steering, episode_keys(seed, seeds))


def plan_of(steered: AbstractController) -> TimeToGo:
    """The plan inside of a controller that `controller` made for a place to reach."""
    parts = jax.tree.leaves(steered, is_leaf=lambda x: isinstance(x, TimeToGo))
    return next(part for part in parts if isinstance(part, TimeToGo))


def _planned_way(
    plan: TimeToGo, route: Route, way: Float[np.ndarray, "time dim"]
) -> PlannedWay:
    return PlannedWay(
        time=plan.time_from(route.ys[0]),
        route_time=float(route.arrival_time),
        unreachable=float(np.mean(plan.unreachable)),
        route=way,
        times=np.where(plan.unreachable, np.inf, plan.map),
        lattice=_lattice(plan) if len(plan.goal) == 2 else None,
    )


def _lattice(plan: TimeToGo) -> PlanLattice:
    """The plan's lattice, of four axes with every second velocity."""
    values = np.asarray(plan.values[0], np.float32)
    every = np.array([2, 2, 1, 1] if values.ndim == 4 else [1, 1])
    return PlanLattice(
        values=values[tuple(slice(None, None, step) for step in every)],
        lower=np.asarray(plan.lower, float),
        spacing=every * np.asarray(plan.spacing, float),
        scale=float(plan.scale),
        ahead=float(plan.step),
        horizon=plan.horizon,
        thrusts=np.asarray(plan.tables.control_map.thrusts(LATTICE_HEADINGS), float),
    )


def _regrets(episodes: Mapping[str, Episodes]) -> dict[str, Interval]:
    """Arrival times over those with the truth, in pairs; medians over seeds."""
    oracle = episodes.get(ORACLE)
    if oracle is None or not oracle.reached.any():
        return {}
    return {
        name: regret(loops, oracle)
        for name, loops in episodes.items()
        if name != ORACLE
    }


def _positions(task: Task, route: Route) -> Float[np.ndarray, "time dim"]:
    """Places along the route, until it arrives."""
    end = np.isfinite(float(route.arrival_time)) and float(route.arrival_time)
    count = round(end / task.step) + 1 if end else len(route.ts)
    return np.asarray(route.ys)[:count, : task.dim]


def _maps(problem: NavigationProblem) -> ForceMaps:
    """Learned and true force on the arena, and the posterior's standard deviation."""
    grid = Course.of(problem.task).grid(MAP_POINTS)
    far = distances(grid.points, problem.fit.data).reshape(grid.distance.shape)
    learned = dataclasses.replace(_map(problem.model, grid), distance=far)
    truth = sd = None
    if problem.truth is not None:
        truth = _map(problem.task.truth, grid)
    if problem.posterior is not None:
        sd = problem.posterior.force_sd(grid.points).reshape(grid.force.shape)
    return ForceMaps(learned, truth, sd)


def _map(swimmer: SteeredSwimmer, grid: FieldMap) -> FieldMap:
    """The force of a swimmer's environment at the points of a map, at first."""
    times = np.zeros(len(grid.points))
    forces = forces_at(swimmer.dynamics.environment, times, grid.points)
    return grid.showing(np.asarray(forces).reshape(grid.force.shape))
