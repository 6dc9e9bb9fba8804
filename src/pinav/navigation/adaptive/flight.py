"""Flights of a controller that learns on the way, judged by the truth."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from pinav.evaluation import normal_quantile
from pinav.learning.findings import ForceMaps
from pinav.navigation.adaptive.prior import with_truth
from pinav.navigation.adaptive.steering import AdaptiveController, ControllerState
from pinav.navigation.belief.belief import Belief
from pinav.navigation.task.steering import physics_only
from pinav.navigation.task.task import Course, Task
from pinav.navigation.trials.closed_loop import episode, last_observation
from pinav.navigation.trials.metrics import (
    Interval,
    Quantiles,
    median,
    proportion,
    quantiles,
)
from pinav.navigation.trials.situation import Situation

ORACLE = "oracle"
"""The controller that knows the true force."""


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
    return error, float(np.mean(np.abs(mean - truth) <= normal_quantile() * sd))


@dataclasses.dataclass(frozen=True, eq=False)
class Flight:
    """The record of a flight, judged by the truth.

    Attributes:
        path: true positions at the frames [L].
        arrival_time: [T]; infinite if it was not.
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


def judge_controllers(
    flights: Mapping[str, Sequence[Flight]], own_limit: float
) -> dict[str, FlightOutcome]:
    """The outcome of each controller, in pairs with the oracle of the same keys.

    A pair whose oracle did not arrive has no regret.

    Args:
        own_limit: time limit of the task itself [T].
    """
    best = np.array([flight.arrival_time for flight in flights[ORACLE]])
    pairs = np.isfinite(best)

    def judge(name: str, some: Sequence[Flight]) -> FlightOutcome:
        times = np.array([flight.arrival_time for flight in some])
        frames = np.concatenate([flight.learn_times for flight in some])
        commands = np.concatenate([flight.command_times[1:] for flight in some])
        plans = np.concatenate([flight.replan_times[1:] for flight in some])
        count, learned, ratio = len(some), name != ORACLE, None
        if learned and pairs.any():
            ratio = median(times[pairs] / best[pairs])
        errors, covers = zip(*((f.force_error, f.cover) for f in some), strict=True)
        return FlightOutcome(
            runs=count,
            success=proportion(sum(flight.reached for flight in some), count),
            in_time=proportion(int(np.sum(times <= own_limit)), count),
            violation=proportion(sum(flight.violated for flight in some), count),
            arrival=quantiles(times[np.isfinite(times)]),
            regret=ratio,
            clearance=min(flight.clearance for flight in some),
            force_error=float(np.median(errors)) if learned else None,
            cover=float(np.mean(covers)) if learned else None,
            consistency=float(np.mean([flight.consistency for flight in some])),
            changed=float(np.mean([flight.changed for flight in some])),
            frame_time=float(np.quantile(frames, 0.99)) if len(frames) else np.nan,
            command_time=float(np.median(commands)) if len(commands) else np.nan,
            replan_time=float(np.median(plans)) if len(plans) else np.nan,
            memory=float(max(flight.memory for flight in some)),
        )

    return {name: judge(name, some) for name, some in flights.items()}


class Visit(NamedTuple):
    """A flight, and what is believed after it."""

    flight: Flight
    belief: Belief
    moments: tuple[Belief, ...]


def fly(
    adaptive: AdaptiveController, *, key: PRNGKeyArray, every: float = math.inf
) -> Visit:
    """One flight, frame by frame; only positions are observed.

    The noise belongs to the key, whatever the controller: flights of two controllers
    with one key are a pair.

    Args:
        every: time between the beliefs that are kept, to be shown [T].
    """
    task, now, memory = adaptive.task, None, None
    places, notes, moments = [], [], []

    def note(now: Situation, memory: ControllerState) -> None:
        belief, place = memory.belief, np.asarray(now.state, float)[:2]
        error = place - belief.state.mean[:2]
        surprise = error @ np.linalg.solve(belief.state.covariance[:2, :2], error) / 2
        changed = memory.verdict is not None and memory.verdict.changed
        times = memory.learn_time, memory.plan_time, memory.command_time
        places.append(place)
        notes.append((surprise, memory.progress.stalled, changed, *times))
        if belief.time >= len(moments) * every - 1e-9:
            moments.append(belief)

    for step in episode(task, adaptive, key=key):
        now, memory = step.after, step.memory
        note(step.before, memory)
    assert now is not None
    assert memory is not None
    memory = adaptive.learn(memory, last_observation(task, now, key))
    note(now, memory)
    path = np.array(places)
    surprise, stalled, changed, *times = np.array(notes, float).T
    learn_times, replan_times, command_times = times
    error, cover = score_force(path, memory.belief, task)
    flight = Flight(
        path=path,
        reached=bool(now.reached),
        violated=bool(now.violated),
        arrival_time=float(now.arrival_time),
        clearance=float(now.clearance),
        consistency=float(np.mean(surprise[1:])),
        changed=int(np.sum(changed[:-1])),  # the last frame has no command
        stalls=int(np.sum(stalled)),
        learn_times=learn_times[np.isfinite(learn_times)],
        command_times=command_times[:-1],
        replan_times=replan_times[np.isfinite(replan_times)],
        memory=memory.belief.nbytes,
        force_error=error,
        cover=cover,
    )
    return Visit(flight, memory.belief, tuple(moments))


MAP_POINTS = 41
"""Points of the maps of the force along each side."""

MOMENTS = 4
"""Beliefs of the first flight that are shown."""

MOMENTS_KEPT = 40
"""Beliefs of the first flight among which those that are shown are chosen."""


def map_belief(task: Task, belief: Belief) -> ForceMaps:
    """The learned force on the arena, and its standard deviation."""
    grid = Course.of(task).grid(MAP_POINTS)
    mean, sd = (part.reshape(grid.force.shape) for part in belief.force(grid.points))
    return ForceMaps(grid.showing(mean), sd=sd)


@dataclasses.dataclass(frozen=True, eq=False)
class ShownFlight:
    """The knowledge of a flight, as figures show it.

    Attributes:
        maps: true force, and learned one at the end.
        mean: learned force along the path, at the end.
        sd: standard deviation of its components.
        means: learned force on the arena at these moments.
    """

    maps: ForceMaps
    truth: Float[np.ndarray, "frame 2"]
    mean: Float[np.ndarray, "frame 2"]
    sd: Float[np.ndarray, "frame 2"]
    times: Float[np.ndarray, " moment"]
    means: Float[np.ndarray, "moment y x 2"]
    sds: Float[np.ndarray, "moment y x 2"]

    @classmethod
    def of(cls, task: Task, visit: Visit) -> "ShownFlight":
        """The figures' part of a flight with moments."""
        path, maps = visit.flight.path, map_belief(task, visit.belief)
        field, (mean, sd) = maps.learned, visit.belief.force(path)
        truth = true_force(task, field.points).reshape(field.force.shape)
        count = len(visit.moments) - 1
        picked = np.linspace(0, count, MOMENTS).round().astype(int)
        moments = [visit.moments[k] for k in picked]
        shown = [map_belief(task, belief) for belief in moments]
        return cls(
            maps=dataclasses.replace(maps, truth=field.showing(truth)),
            truth=true_force(task, path),
            mean=mean,
            sd=sd,
            times=np.array([belief.time for belief in moments]),
            means=np.stack([one.learned.force for one in shown]),
            sds=np.stack([one.sd for one in shown if one.sd is not None]),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class SwimmerFlights:
    """The flights of one swimmer.

    Attributes:
        shown: first visit of the first swimmer; none of others.
    """

    flights: dict[str, Flight]
    shown: ShownFlight | None = None


def fly_swimmer(
    adaptive: AdaptiveController,
    seed: int,
    number: int,
    visits: int,
    *,
    oracle: bool = True,
) -> SwimmerFlights:
    """The oracle's flight and those of each visit, with the same noise.

    Args:
        number: number of the swimmer; the first one is shown.
        visits: visits to the task, with the map kept.

    Raises:
        InputError: the true force changes in time.
    """
    task, key = adaptive.task, jax.random.fold_in(jax.random.key(seed), number)
    flights: dict[str, Flight] = {}
    if oracle:
        flights[ORACLE] = fly(with_truth(adaptive), key=key).flight
    shown = None
    for number_of_visit in range(1, visits + 1):
        is_shown = number == 0 and number_of_visit == 1
        every = task.time_limit / MOMENTS_KEPT if is_shown else math.inf
        visit = fly(adaptive, key=key, every=every)
        flights[f"visit {number_of_visit}"] = visit.flight
        if is_shown:
            shown = ShownFlight.of(task, visit)
        adaptive = dataclasses.replace(adaptive, known=visit.belief)
    return SwimmerFlights(flights, shown)
