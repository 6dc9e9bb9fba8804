"""Closed loops with the learned model, with physics alone, and with the truth."""

from collections.abc import Sequence

import jax
import numpy as np

from pinav.commands.navigate.settings import NavigateSettings
from pinav.commands.navigate.setup import NavigationProblem
from pinav.errors import InputError
from pinav.navigation import (
    AbstractController,
    Episodes,
    concatenate_episodes,
    controller,
    run_many,
)

LEARNED, PHYSICS, ORACLE = "learned", "physics only", "oracle"
"""Models whose plans are tried."""

Attempt = tuple[str, Episodes | str]
"""Name of a model, and closed loops with it, or why it sees no way."""


def models_to_try(problem: NavigationProblem) -> list[str]:
    """Their names; the truth is left out where it is not known."""
    return [LEARNED, PHYSICS, *([ORACLE] if problem.truth is not None else [])]


def controller_of(problem: NavigationProblem, name: str) -> AbstractController:
    """The controller that takes a model for true.

    Args:
        problem: of navigation.
        name: of the model.

    Raises:
        InputError: start or goal are in a wall or outside the arena, or the goal
            cannot be reached with this thrust, as far as the model knows.
    """
    if name == LEARNED:
        return controller(problem.task, problem.model, samples=problem.samples)
    model = problem.physics if name == PHYSICS else problem.task.truth
    return controller(problem.task, model)


def attempt(
    problem: NavigationProblem,
    name: str,
    settings: NavigateSettings,
    steering: AbstractController | None = None,
) -> Attempt:
    """All closed loops with a model; one that sees no way is an answer, too.

    Args:
        problem: of navigation.
        name: of the model.
        settings: of the command.
        steering: its controller, where it was made already.
    """
    try:
        steering = controller_of(problem, name) if steering is None else steering
    except InputError as error:
        return name, str(error)
    return name, trials(problem, steering, settings, range(settings.seeds))


def trials(
    problem: NavigationProblem,
    steering: AbstractController,
    settings: NavigateSettings,
    seeds: Sequence[int],
) -> Episodes:
    """Closed loops of a controller, one for each seed, over the possible truths.

    Args:
        problem: of navigation.
        steering: what decides.
        settings: of the command, whose seeds these are some of.
        seeds: their numbers, ascending.
    """
    truths = problem.truths[: settings.seeds]
    keys = jax.random.split(jax.random.key(settings.seed), settings.seeds)
    numbers = np.asarray(seeds)
    parts, order = [], []
    for index, truth in enumerate(truths):
        some = np.flatnonzero(numbers % len(truths) == index)
        if len(some):
            picked = keys[numbers[some]]
            parts.append(run_many(problem.task, steering, picked, truth=truth))
            order.append(some)
    return concatenate_episodes(parts).select(np.argsort(np.concatenate(order)))
