"""Flights of one swimmer that learns a task on the way."""

import dataclasses
import math
from collections.abc import Mapping

import jax
import numpy as np

from pinav.navigation import Disc, ReachGoal, Task
from pinav.navigation.adaptive.flight import Flight, fly
from pinav.navigation.adaptive.scores import FlightRecord, true_force
from pinav.navigation.adaptive.steering import Adaptive
from pinav.navigation.belief.belief import Belief

MAP_POINTS = 41
"""Points of the maps of the force along each side."""

MOMENTS, MOMENTS_KEPT = 4, 40
"""Beliefs of the first flight that are shown, and those among which are chosen."""

ORACLE = "oracle"
"""The controller that knows the true force."""


@dataclasses.dataclass(frozen=True, eq=False)
class SwimmerFlights:
    """The flights of one swimmer.

    Attributes:
        records: by the controller: the oracle, and each visit.
        shown: arrays behind the figures of the first swimmer; empty for others.
    """

    records: Mapping[str, FlightRecord]
    shown: Mapping[str, np.ndarray]

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All of it, for a file."""
        flown = {
            f"flight/{name}/{field}": array
            for name, record in self.records.items()
            for field, array in record.arrays.items()
        }
        return flown | {f"shown/{name}": array for name, array in self.shown.items()}

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, np.ndarray]) -> "SwimmerFlights":
        """The flights that `arrays` came from."""
        flown: dict[str, dict[str, np.ndarray]] = {}
        shown: dict[str, np.ndarray] = {}
        for key, array in arrays.items():
            part, _, rest = key.partition("/")
            if part == "shown":
                shown[rest] = array
            else:
                name, _, field = rest.partition("/")
                flown.setdefault(name, {})[field] = array
        records = {name: FlightRecord.of_arrays(some) for name, some in flown.items()}
        return cls(records, shown)


def fly_swimmer(
    adaptive: Adaptive, seed: int, number: int, visits: int, *, oracle: bool = True
) -> SwimmerFlights:
    """The oracle's flight and those of each visit, with the same noise.

    Args:
        adaptive: the controller.
        seed: of all noise.
        number: of the swimmer; the first one is shown.
        visits: to the task, with the map kept.
        oracle: whether its flight is wanted.
    """
    problem, key = adaptive.task, jax.random.fold_in(jax.random.key(seed), number)
    records: dict[str, FlightRecord] = {}
    if oracle:
        known = fly(adaptive, key=key, oracle=True)
        records[ORACLE] = FlightRecord.of(known, problem)
    belief: Belief | None = None
    shown: dict[str, np.ndarray] = {}
    for visit in range(1, visits + 1):
        is_shown = number == 0 and visit == 1
        every = problem.time_limit / MOMENTS_KEPT if is_shown else math.inf
        flight = fly(adaptive, key=key, belief=belief, every=every)
        records[f"visit {visit}"] = FlightRecord.of(flight, problem)
        if is_shown:
            shown = _arrays_of_flight(problem, flight)
        belief = flight.belief
    return SwimmerFlights(records, shown)


def _arrays_of_flight(problem: Task, first: Flight) -> dict[str, np.ndarray]:
    """What the figures show of the first flight, and of the task."""
    lower, upper = np.asarray(problem.arena.lower), np.asarray(problem.arena.upper)
    x, y = np.linspace(lower, upper, MAP_POINTS).T
    points = np.stack(np.meshgrid(x, y), axis=-1)
    flat, shape = points.reshape(-1, 2), points.shape
    goal = problem.objective
    assert isinstance(goal, ReachGoal)
    discs = [[*z.center, z.radius] for z in problem.keep_out if isinstance(z, Disc)]
    path = first.states[:, :2]
    mean, sd = first.belief.force(path)
    arrays = {
        "arena": np.array([lower, upper]),
        "start": np.asarray(problem.start[:2]),
        "goal": np.asarray(goal.goal),
        "tolerance": np.asarray(goal.tolerance),
        "discs": np.array(discs).reshape(-1, 3),
        "step": np.asarray(problem.step),
        "field/x": x,
        "field/y": y,
        "field/true": true_force(problem, flat).reshape(shape),
        "band/true": true_force(problem, path),
        "band/mean": mean,
        "band/sd": sd,
    }
    learned, spread = first.belief.force(flat)
    arrays["field/learned"] = learned.reshape(shape)
    arrays["field/sd"] = spread.reshape(shape)
    picked = np.linspace(0, len(first.moments) - 1, MOMENTS).round().astype(int)
    moments = [first.moments[k] for k in picked]
    arrays["moments/time"] = np.array([belief.time for belief in moments])
    for name, part in (("mean", 0), ("sd", 1)):
        maps = [belief.force(flat)[part].reshape(shape) for belief in moments]
        arrays[f"moments/{name}"] = np.stack(maps)
    return arrays
