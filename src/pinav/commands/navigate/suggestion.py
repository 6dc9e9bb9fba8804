"""Which trajectory to record next, for the route of `pinav navigate`."""

from typing import Any

import equinox as eqx
import jax
import numpy as np

from pinav.commands.navigate.settings import NavigateSettings
from pinav.commands.navigate.setup import Fitted, NavigationProblem
from pinav.dynamics import FixedStep
from pinav.navigation.design.candidates import CandidateTrajectories, Experiment
from pinav.navigation.design.information import rank, suggest
from pinav.navigation.design.prior import PriorField, prior_uncertainty
from pinav.navigation.task.zones import Rectangle
from pinav.runs import RunFolder

CANDIDATES, ROUNDS = 48, 3
"""CandidateTrajectories in each round, and rounds."""

SAMPLES = 120
"""Samples of a suggested trajectory at most."""

STRENGTH = 0.5
"""Forces that there may be where nobody was, in units of the greatest thrust."""


def suggestion(
    settings: NavigateSettings,
    problem: NavigationProblem,
    fitted: Fitted,
    route: np.ndarray,
    folder: RunFolder,
) -> tuple[dict[str, Any], np.ndarray]:
    """The trajectory that would tell most of the force along the route.

    Its commands go to `suggestion.csv`.

    Returns:
        What is expected of it, and its predicted path.
    """
    task = problem.task
    prior = PriorField(task.arena, STRENGTH * settings.thrust)
    uncertainty = prior_uncertainty(
        problem.model.dynamics,
        fitted.data,
        fitted.states,
        noise=fitted.noise,
        prior=prior,
    )
    design = _experiment(settings, problem, fitted)
    key = jax.random.fold_in(jax.random.key(settings.seed), 2)
    candidates = design.draw(CANDIDATES, key=key)
    random = rank(uncertainty, route, design, candidates, arena=task.arena)
    found = suggest(
        uncertainty,
        route,
        design,
        arena=task.arena,
        key=key,
        num_candidates=CANDIDATES,
        rounds=ROUNDS,
    )
    best = found.candidates[found.best]
    table = [design.knots.tolist(), best.frequency.tolist(), best.heading.tolist()]
    rows = list(zip(*table, strict=True))
    folder.write_table("suggestion.csv", ("t", "frequency", "heading"), rows)
    stays = np.isfinite(random.worth)
    expected = {
        "start": best.starts[:2].tolist(),
        "duration": design.duration,
        "sd": found.sd_now,
        "sd_after": float(found.sd[found.best]),
        "sd_after_random": float(np.median(random.sd[stays])) if stays.any() else None,
    }
    return expected, _path(problem, design, best)


def _experiment(
    settings: NavigateSettings, problem: NavigationProblem, fitted: Fitted
) -> Experiment:
    """Released near the start, observed as the data were."""
    task, data = problem.task, fitted.data
    near = np.full(2, settings.tolerance)
    start = np.asarray(task.start[:2])
    spans = [piece.times[-1] - piece.times[0] for piece in data]
    interval = float(np.median(np.concatenate([np.diff(p.times) for p in data])))
    duration = min(settings.time_limit, float(np.median(spans)), SAMPLES * interval)
    noise = np.full(len(task.start), np.inf)
    seen = np.flatnonzero(data.observed.any(axis=(0, 1)))
    noise[seen] = fitted.noise
    return Experiment(
        actuator=task.truth.actuator,
        limits=task.limits,
        region=Rectangle(start - near, start + near),
        noise=noise,
        duration=duration,
        interval=interval,
        knot=max(duration / 8, interval),
        turning=1.2 / (duration / 8) ** 0.5,
    )


def _path(
    problem: NavigationProblem, design: Experiment, candidate: CandidateTrajectories
) -> np.ndarray:
    """Where the model expects it to go."""
    driven = eqx.tree_at(
        lambda m: m.propulsion, problem.model.dynamics, design.thrust(candidate)
    )
    states, _ = FixedStep().solve(driven, candidate.starts, design.times)
    return np.asarray(states)[:, :2]
