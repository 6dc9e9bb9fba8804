"""`pinav navigate`: plan on a learned force, and try it in closed loop."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from pinav.commands.command import CommandResult
from pinav.commands.navigate import NAVIGATE, online, online_tables
from pinav.commands.navigate.cells import sweep_flights, sweep_loops
from pinav.commands.navigate.loops import (
    LEARNED,
    Attempt,
    attempt,
    controller_of,
    models_to_try,
)
from pinav.commands.navigate.metrics import (
    ControllerRow,
    IntervalRow,
    NavigationMetrics,
    PlanRow,
    StepTimes,
)
from pinav.commands.navigate.settings import NavigateOptions, NavigateSettings
from pinav.commands.navigate.setup import NavigationProblem, navigation_problem
from pinav.commands.navigate.suggestion import Suggestion, suggest_trajectory
from pinav.commands.navigate.tables import text
from pinav.commands.start import start_run
from pinav.commands.sweep import start_sweep
from pinav.commands.worker_settings import WorkerSettings
from pinav.evaluation import distances
from pinav.forces import forces_at
from pinav.learning.learned import Learned
from pinav.navigation import (
    AbstractController,
    Episodes,
    Route,
    SteeredSwimmer,
    Task,
    TimeToGo,
    regret,
    summary,
)
from pinav.navigation import run as run_episode
from pinav.runs import RunFolder
from pinav.threads import map_on_cores

MAP_POINTS = 61
"""Points of the maps along each side."""

PAGE_HEADINGS = 24
"""Directions of the thrust that the explorer's page tries."""

Arrays = dict[str, np.ndarray]


def navigate(
    settings: NavigateSettings,
    problem: NavigationProblem,
    folder: RunFolder,
    sweep: Callable[[Sequence[str]], list[Attempt]] | None = None,
) -> NavigationMetrics:
    """Plan, try in closed loop, and write the results.

    Args:
        settings: of the command.
        problem: of navigation.
        folder: of the run.
        sweep: lets workers try models, by their names; here unless given.

    Raises:
        InputError: start or goal are in a wall or outside the arena, or the goal
            cannot be reached with this thrust, as far as the model knows.
    """
    task = problem.task
    steered = controller_of(problem, LEARNED)
    plan = plan_of(steered)
    route = plan.route(task.start, task.step)
    path = _path(task, route)

    def suggest() -> Suggestion | None:
        if problem.evidence is None:
            return None
        return suggest_trajectory(settings, problem, problem.evidence, path, folder)

    models = models_to_try(problem)
    if sweep is not None:
        tried, suggested = sweep(models), suggest()
    else:
        # The first loops compile what the others need, while these are planned.
        attempts = [
            partial(attempt, problem, LEARNED, settings, steered),
            *(partial(attempt, problem, name, settings) for name in models[1:]),
        ]
        *tried, suggested = map_on_cores(_call, [*attempts, suggest], title="loops")
    episodes = {name: runs for name, runs in tried if isinstance(runs, Episodes)}
    refused = {name: reason for name, reason in tried if isinstance(reason, str)}
    arrays, suggestion = _arrays(problem, plan, path, episodes), None
    if suggested is not None:
        suggestion, arrays["suggestion"] = suggested
    metrics = NavigationMetrics(
        truth=problem.truth,
        plan=_plan_row(plan, route),
        controllers={
            name: ControllerRow.of_summary(summary(runs, task))
            for name, runs in episodes.items()
        },
        regret=_regrets(episodes),
        refused=refused,
        step=_step_times(problem, steered, settings),
        units=problem.data.units,
        order=problem.order,
        force=problem.force,
        thrust=problem.thrust,
        delay=task.delay,
        suggestion=suggestion,
    )
    folder.write_arrays("results.npz", arrays)
    folder.write_metrics("metrics.json", metrics)
    return metrics


def _call(job: Callable[[], Any]) -> Any:
    return job()


def plan_of(steered: AbstractController) -> TimeToGo:
    """The plan inside of a controller that `controller` made for a place to reach."""
    parts = jax.tree.leaves(steered, is_leaf=lambda x: isinstance(x, TimeToGo))
    return next(part for part in parts if isinstance(part, TimeToGo))


def _plan_row(plan: TimeToGo, route: Route) -> PlanRow:
    arrival = float(route.arrival_time)
    return PlanRow(
        time=plan.time_from(route.ys[0]),
        route_time=arrival if np.isfinite(arrival) else None,
        unreachable=float(np.mean(plan.unreachable)),
    )


def _regrets(episodes: Mapping[str, Episodes]) -> dict[str, IntervalRow]:
    """Arrival times over those with the truth, in pairs; medians over seeds."""
    oracle = episodes.get("oracle")
    if oracle is None or not oracle.reached.any():
        return {}
    return {
        name: IntervalRow.of(regret(runs, oracle))
        for name, runs in episodes.items()
        if name != "oracle"
    }


def _step_times(
    problem: NavigationProblem, steering: AbstractController, settings: NavigateSettings
) -> StepTimes:
    """Time that one command takes to compute [s], and the first one."""
    key = jax.random.key(settings.seed)
    compute = run_episode(problem.task, steering, key=key).compute
    return StepTimes(first=float(compute[0]), median=float(np.median(compute[1:])))


def _path(task: Task, route: Route) -> Float[np.ndarray, "time dim"]:
    """Places along the route, until it arrives."""
    end = np.isfinite(float(route.arrival_time)) and float(route.arrival_time)
    count = round(end / task.step) + 1 if end else len(route.ts)
    return np.asarray(route.ys)[:count, : task.dim]


def _arrays(
    problem: NavigationProblem,
    plan: TimeToGo,
    path: Float[np.ndarray, "time dim"],
    episodes: Mapping[str, Episodes],
) -> Arrays:
    """Everything that the figures need."""
    task = problem.task
    arrays = {
        "arena": np.array([task.arena.lower, task.arena.upper]),
        "start": np.asarray(task.start[: task.dim]),
        "goal": np.asarray(problem.goal.goal),
        "tolerance": np.asarray(problem.goal.tolerance),
        "discs": np.array([[*z.center, z.radius] for z in problem.discs]),
        "step": np.asarray(task.step),
        "route": path,
        "plan/time": np.where(plan.unreachable, np.inf, plan.map),
    }
    if task.dim == 2:
        arrays |= _lattice(plan) | _maps(problem)
    for name, runs in episodes.items():
        arrays[f"states/{name}"] = runs.states
        arrays[f"steps/{name}"] = runs.steps
        arrays[f"reached/{name}"] = runs.reached
    return arrays


def _lattice(plan: TimeToGo) -> Arrays:
    """The plan as the explorer's page takes it, every second velocity of four axes."""
    values = np.asarray(plan.values[0], np.float32)
    every = np.array([2, 2, 1, 1] if values.ndim == 4 else [1, 1])
    return {
        "plan/values": values[tuple(slice(None, None, step) for step in every)],
        "plan/lower": np.asarray(plan.lower),
        "plan/spacing": every * np.asarray(plan.spacing),
        "plan/scale": np.asarray(plan.scale),
        "plan/ahead": np.asarray(plan.step),
        "plan/horizon": np.asarray(plan.horizon),
        "plan/thrusts": np.asarray(plan.tables.control_map.thrusts(PAGE_HEADINGS)),
    }


def _maps(problem: NavigationProblem) -> Arrays:
    """Learned and true force on the arena, with its sd and the distance to the data."""
    corners = problem.task.arena.lower, problem.task.arena.upper
    lower, upper = map(np.asarray, corners)
    x, y = np.linspace(lower, upper, MAP_POINTS).T
    points = np.stack(np.meshgrid(x, y), axis=-1)
    flat, shape = points.reshape(-1, 2), points.shape
    maps = {
        "field/x": x,
        "field/y": y,
        "field/learned": _forces(problem.model, flat).reshape(shape),
        "field/distance": distances(flat, problem.data).reshape(shape[:2]),
    }
    if problem.truth is not None:
        maps["field/true"] = _forces(problem.task.truth, flat).reshape(shape)
    if problem.evidence is not None:
        sd = problem.evidence.posterior.force_sd(flat)
        maps["field/sd"] = sd.reshape(shape)
    return maps


def _forces(
    swimmer: SteeredSwimmer, points: Float[np.ndarray, "point 2"]
) -> Float[np.ndarray, "point 2"]:
    times = np.zeros(len(points))
    return np.asarray(forces_at(swimmer.dynamics.environment, times, points))


def run(options: NavigateOptions) -> CommandResult:
    """Navigate as the command line does."""
    if options.run is None:
        return _learn_online(options)
    settings, run = options.settings, options.run
    problem = navigation_problem(settings, Learned.open(run))
    if options.workers == WorkerSettings():
        folder = start_run(NAVIGATE, options, settings, fitted=run.name)
        metrics = navigate(settings, problem, folder)
    else:
        with start_sweep(
            NAVIGATE, options, options.workers, settings, fitted=run.name
        ) as sweep:
            folder = sweep.folder
            swept = partial(sweep_loops, sweep, settings, run)
            metrics = navigate(settings, problem, folder, swept)
    return CommandResult(metrics, text(metrics), folder)


def _learn_online(options: NavigateOptions) -> CommandResult:
    settings, learning, prior = options.settings, options.online, options.prior
    problem = online.online_problem(settings, learning, prior)
    identity = {} if prior is None else {"prior": prior.name}
    with start_sweep(
        NAVIGATE, options, options.workers, settings, learning, **identity
    ) as sweep:
        swimmers = sweep_flights(sweep, settings, learning, prior)
        metrics = online.write_online(problem, learning, swimmers, sweep.folder)
        return CommandResult(metrics, online_tables.text(metrics), sweep.folder)
