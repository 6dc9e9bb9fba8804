"""Judges what a flight has learned, by the truth."""

import dataclasses
from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.navigation.belief.belief import Belief
from pinav.navigation.task.steering import physics_only
from pinav.navigation.task.task import Task
from pinav.navigation.trials.metrics import (
    Interval,
    Quantiles,
    median,
    proportion,
    quantiles,
)

ORACLE = "oracle"
"""The controller that knows the true force."""

NOMINAL = 1.96
"""Half width of a band of 95 %, in standard deviations."""


def true_force(
    task: Task, positions: Float[np.ndarray, "point 2"]
) -> Float[np.ndarray, "point 2"]:
    """True contribution of the environment to the rate of a swimmer at rest."""
    physics, rest = physics_only(task.truth), jnp.zeros(len(task.start) - 2)

    def at(x: Float[Array, "2"]) -> Float[Array, "2"]:
        state, idle = jnp.concatenate([x, rest]), jnp.zeros(2)
        return (task.truth(0.0, state, idle) - physics(0.0, state, idle))[-2:]

    return np.asarray(jax.vmap(at)(jnp.asarray(positions)), float)


def score_force(
    path: Float[np.ndarray, "point 2"], belief: Belief, task: Task
) -> tuple[float, float]:
    """Error and cover of a belief along the true path.

    Returns:
        Root sum of squared errors of the force over that of the force, and the fraction
        of its components within their bands of 95 %.
    """
    truth = true_force(task, path)
    mean, sd = belief.force(path)
    error = float(np.linalg.norm(mean - truth) / np.linalg.norm(truth))
    return error, float(np.mean(np.abs(mean - truth) <= NOMINAL * sd))


@dataclasses.dataclass(frozen=True, eq=False)
class Flight:
    """The record of a flight, judged by the truth.

    Attributes:
        path: true positions at the frames [L].
        arrival_time: [T]; infinite if it was not.
        consistency: mean of the squared error of the position over its variance.
        changed: commands that the safety filter changed.
        stalls: frames at which no progress was noticed.
        learn_times: computing time of each frame [s].
        command_times: computing time of each command [s].
        replan_times: computing time of each later plan [s].
        memory: of the belief at the end [byte].
        force_error: of the belief along the path; see `score_force`.
        cover: of its bands there.
    """

    path: Float[np.ndarray, "frame 2"]
    reached: bool
    violated: bool
    arrival_time: float
    clearance: float
    consistency: float
    changed: int
    stalls: int
    learn_times: Float[np.ndarray, " control"]
    command_times: Float[np.ndarray, " control"]
    replan_times: Float[np.ndarray, " plan"]
    memory: int
    force_error: float
    cover: float


@dataclasses.dataclass(frozen=True, eq=False)
class FlightOutcome:
    """Flights of one controller on one task.

    Attributes:
        success: proportion that arrived without a violation.
        in_time: proportion that arrived within the task's own time limit.
        violation: proportion that entered a forbidden place.
        regret: median over pairs of arrival time / the oracle's; none for the oracle.
        force_error: median error of the force over the visited path; none for the
            oracle.
        cover: mean fraction of true forces within their bands of 95 %, there.
        consistency: mean of the squared error of the position over its variance.
        changed: mean number of commands that the safety filter changed.
        frame_time: 99 % quantile of the computing time of a frame [s].
        command_time: median computing time of a command [s].
        replan_time: median computing time of a plan [s].
        memory: greatest memory of a belief at the end [byte].
    """

    runs: int
    success: Interval
    in_time: Interval
    violation: Interval
    arrival: Quantiles
    regret: Interval | None
    clearance: float
    force_error: float | None
    cover: float | None
    consistency: float
    changed: float
    frame_time: float
    command_time: float
    replan_time: float
    memory: float


def judge_flights(
    flights: Sequence[Flight],
    own_limit: float,
    oracle: Sequence[Flight] = (),
) -> FlightOutcome:
    """The outcome of some flights.

    Args:
        flights: flights of one controller.
        own_limit: time limit of the task itself [T].
        oracle: flights with the truth, of the same keys; none for the oracle itself.
            A pair whose oracle did not arrive has no regret.
    """
    times = np.array([flight.arrival_time for flight in flights])
    arrived = times[np.isfinite(times)]
    count, ratio = len(flights), None
    if oracle:
        best = np.array([flight.arrival_time for flight in oracle])
        pairs = np.isfinite(best)
        ratio = median(times[pairs] / best[pairs]) if pairs.any() else None
    frames = np.concatenate([flight.learn_times for flight in flights])
    commands = np.concatenate([flight.command_times[1:] for flight in flights])
    plans = np.concatenate([flight.replan_times[1:] for flight in flights])
    return FlightOutcome(
        runs=count,
        success=proportion(sum(flight.reached for flight in flights), count),
        in_time=proportion(int(np.sum(times <= own_limit)), count),
        violation=proportion(sum(flight.violated for flight in flights), count),
        arrival=quantiles(arrived),
        regret=ratio,
        clearance=min(flight.clearance for flight in flights),
        force_error=float(np.median([f.force_error for f in flights]))
        if oracle
        else None,
        cover=float(np.mean([f.cover for f in flights])) if oracle else None,
        consistency=float(np.mean([flight.consistency for flight in flights])),
        changed=float(np.mean([flight.changed for flight in flights])),
        frame_time=float(np.quantile(frames, 0.99)) if len(frames) else np.nan,
        command_time=float(np.median(commands)) if len(commands) else np.nan,
        replan_time=float(np.median(plans)) if len(plans) else np.nan,
        memory=float(max(flight.memory for flight in flights)),
    )


def judge_controllers(
    flights: Mapping[str, Sequence[Flight]], own_limit: float
) -> dict[str, FlightOutcome]:
    """The outcome of each controller, in pairs with the oracle."""
    oracle = flights[ORACLE]
    return {
        name: judge_flights(some, own_limit, oracle if name != ORACLE else ())
        for name, some in flights.items()
    }
