"""`pinav navigate`: plan on a learned force, and try it in closed loop."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray, Shaped
from tqdm import tqdm

from pinav.commands.command import CommandResult
from pinav.commands.navigate.command import NAVIGATE
from pinav.commands.navigate.settings import NavigateOptions, NavigateSettings
from pinav.commands.navigate.setup import NavigationProblem, navigation_problem
from pinav.commands.navigate.suggestion import suggestion
from pinav.commands.navigate.tables import controller_row, interval, text
from pinav.commands.start import start_run
from pinav.errors import InputError
from pinav.evaluation import distances
from pinav.navigation.control.controller import AbstractController
from pinav.navigation.control.default import controller
from pinav.navigation.planning.plan import Route, TimeToGo
from pinav.navigation.task.steering import SteeredSwimmer
from pinav.navigation.trials.closed_loop import Episodes, concatenate_episodes, run_many
from pinav.navigation.trials.closed_loop import run as run_episode
from pinav.navigation.trials.metrics import regret, summary
from pinav.runs import RunFolder

MAP_POINTS = 61
"""Points of the maps along each side."""


def navigate(
    settings: NavigateSettings, problem: NavigationProblem, folder: RunFolder
) -> dict[str, Any]:
    """Plan, try in closed loop, and write the results.

    Returns:
        The content of `metrics.json`.

    Raises:
        InputError: start or goal are in a wall or outside the arena, or the goal
            cannot be reached with this thrust, as far as the model knows.
    """
    task = problem.task
    steered = controller(task, problem.model, samples=problem.samples)
    plan = plan_of(steered)
    route = plan.route(task.start, task.step)
    controllers: dict[str, AbstractController] = {"learned": steered}
    others, refused = _others(problem)
    controllers |= others
    found = {}
    for name in tqdm(controllers, desc="closed loop", unit="controller"):
        found[name] = trials(problem, controllers[name], settings)
    metrics = {
        "truth": problem.truth,
        "units": problem.units,
        "thrust": settings.thrust,
        "plan": _planned(plan, route),
        "controllers": {
            name: controller_row(summary(episodes, task))
            for name, episodes in found.items()
        },
        "regret": _regrets(found),
        "refused": refused,
        "step": _step_times(problem, controllers["learned"], settings),
    }
    arrays = _arrays(problem, plan, route, found)
    if problem.fitted is not None:
        metrics["suggestion"], path = suggestion(
            settings, problem, problem.fitted, arrays["route"], folder
        )
        arrays["suggestion"] = path
    folder.write_arrays("results.npz", arrays)
    folder.write_json("metrics.json", metrics)
    return folder.read_json("metrics.json")


def plan_of(steered: AbstractController) -> TimeToGo:
    """The plan inside of a controller that `controller` made for a place to reach."""
    parts = jax.tree.leaves(steered, is_leaf=lambda x: isinstance(x, TimeToGo))
    return next(part for part in parts if isinstance(part, TimeToGo))


def _others(
    problem: NavigationProblem,
) -> tuple[dict[str, AbstractController], dict[str, str]]:
    """Physics alone, and the same controller with the truth where it is known.

    A model that sees no way is an answer, too: those and their reasons come second.
    """
    models = {"physics only": problem.physics}
    if problem.truth is not None:
        models["oracle"] = problem.task.truth
    controllers, refused = {}, {}
    for name, model in models.items():
        try:
            controllers[name] = controller(problem.task, model)
        except InputError as error:
            refused[name] = str(error)
    return controllers, refused


def trials(
    problem: NavigationProblem, steering: AbstractController, settings: NavigateSettings
) -> Episodes:
    """Closed loops of a controller, over seeds and over the possible truths."""
    truths = problem.truths[: settings.seeds]
    keys = _keys(settings)
    parts = [
        run_many(problem.task, steering, keys[index :: len(truths)], truth=truth)
        for index, truth in enumerate(truths)
    ]
    return concatenate_episodes(parts)


def _keys(settings: NavigateSettings) -> Shaped[PRNGKeyArray, " episode"]:
    return jax.random.split(jax.random.key(settings.seed), settings.seeds)


def _planned(plan: TimeToGo, route: Route) -> dict[str, Any]:
    return {
        "time": float(plan.at(route.ys[0])),
        "route_time": float(route.arrival_time),
        "unreachable": float(np.mean(plan.unreachable)),
    }


def _regrets(found: dict[str, Episodes]) -> dict[str, Any]:
    """ArrivalTest times over those with the truth, in pairs; medians over seeds."""
    oracle = found.get("oracle")
    if oracle is None or not oracle.reached.any():
        return {}
    return {
        name: interval(regret(episodes, oracle))
        for name, episodes in found.items()
        if name != "oracle"
    }


def _step_times(problem, steering, settings) -> dict[str, float]:
    """Time that one command takes to compute [s], and the first one."""
    key = _keys(settings)[0]
    compute = run_episode(problem.task, steering, key=key).compute
    return {"first": float(compute[0]), "median": float(np.median(compute[1:]))}


def _arrays(
    problem: NavigationProblem, plan: TimeToGo, route: Route, found: dict[str, Episodes]
) -> dict[str, np.ndarray]:
    """What the figures need."""
    task = problem.task
    end = np.isfinite(float(route.arrival_time)) and float(route.arrival_time)
    count = int(round(end / task.step)) + 1 if end else len(route.ts)
    arrays = {
        "arena": np.array([task.arena.lower, task.arena.upper]),
        "start": np.asarray(task.start[:2]),
        "goal": np.asarray(problem.goal.goal),
        "tolerance": np.asarray(problem.goal.tolerance),
        "discs": np.array([[*z.center, z.radius] for z in problem.discs]),
        "step": np.asarray(task.step),
        "route": np.asarray(route.ys)[:count, :2],
        "plan/time": np.where(plan.unreachable, np.inf, plan.map),
        **_maps(problem),
    }
    for name, episodes in found.items():
        arrays[f"states/{name}"] = episodes.states
        arrays[f"steps/{name}"] = episodes.steps
        arrays[f"reached/{name}"] = episodes.reached
    return arrays


def _maps(problem: NavigationProblem) -> dict[str, np.ndarray]:
    """Learned and true force on the arena, with its sd and the way to the data."""
    corners = problem.task.arena.lower, problem.task.arena.upper
    lower, upper = map(np.asarray, corners)
    x, y = np.linspace(lower, upper, MAP_POINTS).T
    points = np.stack(np.meshgrid(x, y), axis=-1)
    flat, shape = points.reshape(-1, 2), points.shape
    found = {"field/x": x, "field/y": y}
    found["field/learned"] = _forces(problem.model, flat).reshape(shape)
    if problem.truth is not None:
        found["field/true"] = _forces(problem.task.truth, flat).reshape(shape)
    if problem.fitted is not None:
        found["field/sd"] = problem.fitted.posterior.force_sd(flat).reshape(shape)
    if problem.data is not None:
        found["field/distance"] = distances(flat, problem.data).reshape(shape[:2])
    return found


def _forces(swimmer: SteeredSwimmer, points: np.ndarray) -> np.ndarray:
    environment = swimmer.dynamics.environment

    def at(x):
        return environment(0.0, x, jnp.zeros_like(x))

    return np.asarray(jax.vmap(at)(jnp.asarray(points)))


def run(options: NavigateOptions) -> CommandResult:
    """Navigate as the command line does."""
    settings = options.settings
    problem = navigation_problem(settings, RunFolder.open(options.run))
    folder = start_run(NAVIGATE, options, settings, fitted=options.run.name)
    metrics = navigate(settings, problem, folder)
    return CommandResult(metrics, text(metrics), folder)
