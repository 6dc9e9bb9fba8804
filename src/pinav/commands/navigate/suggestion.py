"""The trajectory to record next, for the route of `pinav navigate`."""

from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from pinav.commands.navigate.metrics import SuggestionRow
from pinav.commands.navigate.settings import NavigateSettings
from pinav.commands.navigate.setup import Evidence, NavigationProblem
from pinav.dynamics import FixedStep
from pinav.navigation import (
    CandidateTrajectories,
    Experiment,
    PriorField,
    Rectangle,
    prior_uncertainty,
    rank,
    suggest,
)
from pinav.runs import RunFolder

CANDIDATES, ROUNDS = 48, 3
"""Candidate trajectories in each round, and rounds."""

SAMPLES = 120
"""Samples of a suggested trajectory at most."""

STRENGTH = 0.5
"""Forces that there may be away from the data, in units of the greatest thrust."""


Suggestion = tuple[SuggestionRow, Float[np.ndarray, "sample 2"]]
"""What is expected of a trajectory, and its predicted path."""


def suggest_trajectory(
    settings: NavigateSettings,
    problem: NavigationProblem,
    evidence: Evidence,
    route: Float[np.ndarray, "time 2"],
    folder: RunFolder,
) -> Suggestion:
    """The trajectory that would tell most about the force along the route.

    Its commands go to `suggestion.csv`.
    """
    task = problem.task
    uncertainty = prior_uncertainty(
        problem.model.dynamics,
        problem.data,
        evidence.states,
        noise=evidence.noise,
        prior=PriorField(task.arena, STRENGTH * problem.thrust),
    )
    design = _experiment(settings, problem, evidence)
    key = jax.random.fold_in(jax.random.key(settings.seed), 2)
    drawn = design.draw(CANDIDATES, key=key)
    random = rank(uncertainty, route, design, drawn, arena=task.arena)
    ranking = suggest(
        uncertainty,
        route,
        design,
        arena=task.arena,
        key=key,
        num_candidates=CANDIDATES,
        rounds=ROUNDS,
    )
    best = ranking.candidates[ranking.best]
    table = [design.knots.tolist(), best.frequency.tolist(), best.heading.tolist()]
    rows = list(zip(*table, strict=True))
    folder.write_table("suggestion.csv", ("t", "frequency", "heading"), rows)
    inside = np.isfinite(random.worth)
    x, y = best.starts[:2].tolist()
    expected = SuggestionRow(
        start=(x, y),
        duration=design.duration,
        sd=ranking.sd_now,
        sd_after=float(ranking.sd[ranking.best]),
        sd_after_random=float(np.median(random.sd[inside])) if inside.any() else None,
    )
    return expected, _path(problem, design, best)


def _experiment(
    settings: NavigateSettings, problem: NavigationProblem, evidence: Evidence
) -> Experiment:
    """Released near the start, observed as the data were."""
    task, data = problem.task, problem.data
    near = np.full(2, settings.tolerance)
    start = np.asarray(task.start[:2])
    spans = [piece.times[-1] - piece.times[0] for piece in data]
    interval = float(np.median(np.concatenate([np.diff(p.times) for p in data])))
    duration = min(settings.time_limit, float(np.median(spans)), SAMPLES * interval)
    noise = np.full(len(task.start), np.inf)
    channels = np.flatnonzero(data.observed.any(axis=(0, 1)))
    noise[channels] = evidence.noise
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
) -> Float[np.ndarray, "time 2"]:
    """Its path as the model predicts it."""
    return np.asarray(_states(problem.model, design, candidate))[:, :2]


@eqx.filter_jit
def _states(
    model: Any, design: Experiment, candidate: CandidateTrajectories
) -> Float[Array, "time state"]:
    driven = model.with_propulsion(design.thrust(candidate))
    states, _ = FixedStep().solve(driven, candidate.starts, design.times)
    return states
