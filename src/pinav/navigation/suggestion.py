"""The trajectory to record next, for a planned route."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from pinav.dynamics import FixedStep
from pinav.errors import InputError
from pinav.navigation.design.candidates import CandidateTrajectories, Experiment
from pinav.navigation.design.information import PosteriorInformation, best_candidate
from pinav.navigation.design.result import PriorField, prior_uncertainty
from pinav.navigation.problem import Evidence, NavigationProblem
from pinav.navigation.task.task import Rectangle

CANDIDATES = 48
"""Candidate trajectories in each round."""

ROUNDS = 3
"""Rounds of the search."""

SAMPLES = 120
"""Samples of a suggested trajectory at most."""

STRENGTH = 0.5
"""Forces that there may be away from the data, in units of the greatest thrust."""


@dataclasses.dataclass(frozen=True, eq=False)
class Suggestion:
    """The trajectory that should be recorded next.

    Attributes:
        sd: standard deviation of the force along the route now.
        sd_after: the same, expected after the trajectory.
        sd_after_random: the same, expected after a random one; none where all of these
            leave the arena.
        path: predicted positions [L].
    """

    sd: float
    sd_after: float
    sd_after_random: float | None
    start: tuple[float, float]
    duration: float
    times: Float[np.ndarray, " knot"]
    frequency: Float[np.ndarray, " knot"]
    heading: Float[np.ndarray, " knot"]
    path: Float[np.ndarray, "sample 2"]


def suggest_trajectory(
    problem: NavigationProblem, route: Float[np.ndarray, "time 2"], *, seed: int
) -> Suggestion | None:
    """The trajectory that would tell most about the force along a route.

    Returns:
        The trajectory; none where the fit has no evidence that one could improve.

    Raises:
        InputError: every candidate leaves the arena.
    """
    evidence = problem.evidence
    if evidence is None:
        return None
    task = problem.task
    uncertainty = prior_uncertainty(
        problem.model.dynamics,
        problem.data,
        evidence.states,
        noise=evidence.noise,
        prior=PriorField(task.arena, STRENGTH * problem.thrust),
    )
    design = _experiment(problem, evidence)
    expected_sd = PosteriorInformation.of(uncertainty, route, design, task.arena)
    key = jax.random.fold_in(jax.random.key(seed), 2)
    drawn = design.draw(CANDIDATES, key=key)
    random = np.array([expected_sd(drawn[k]) for k in range(CANDIDATES)])
    _, first, *later = jax.random.split(key, ROUNDS + 1)
    best, sd_after = best_candidate(
        expected_sd,
        design,
        design.draw(CANDIDATES, key=first),
        variations=CANDIDATES - 1,
        keys=later,
    )
    if not np.isfinite(sd_after):
        raise InputError(
            "suggest: each of the candidates leaves the arena; expected one that "
            "stays inside, so make trajectories shorter or the arena larger"
        )
    inside = np.isfinite(random)
    x, y = np.asarray(best.starts[:2], float).tolist()
    return Suggestion(
        sd=expected_sd.sd_now,
        sd_after=sd_after,
        sd_after_random=float(np.median(random[inside])) if inside.any() else None,
        start=(x, y),
        duration=design.duration,
        times=np.asarray(design.knots, float),
        frequency=np.asarray(best.frequency, float),
        heading=np.asarray(best.heading, float),
        path=_path(problem, design, best),
    )


def _experiment(problem: NavigationProblem, evidence: Evidence) -> Experiment:
    """Released near the start, observed as the data were."""
    task, data = problem.task, problem.data
    near = np.full(2, problem.goal.tolerance)
    start = np.asarray(task.start[:2])
    spans = [piece.times[-1] - piece.times[0] for piece in data]
    interval = float(np.median(np.concatenate([np.diff(p.times) for p in data])))
    duration = min(task.time_limit, float(np.median(spans)), SAMPLES * interval)
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
