"""Flights of one swimmer that learns a task on the way, and of the oracle."""

import dataclasses
import math

import jax
import numpy as np
from jaxtyping import Float

from pinav.navigation.adaptive.flight import Visit, fly
from pinav.navigation.adaptive.prior import with_truth
from pinav.navigation.adaptive.scores import ORACLE, Flight, true_force
from pinav.navigation.adaptive.steering import AdaptiveController
from pinav.navigation.maps import ArenaGrid, Course, ForceMaps
from pinav.navigation.task.task import Task

MAP_POINTS = 41
"""Points of the maps of the force along each side."""

MOMENTS = 4
"""Beliefs of the first flight that are shown."""

MOMENTS_KEPT = 40
"""Beliefs of the first flight among which those that are shown are chosen."""


@dataclasses.dataclass(frozen=True, eq=False)
class ShownFlight:
    """The knowledge of a flight, as figures show it.

    Attributes:
        maps: true force, and learned one at the end.
        truth: true force along the path.
        mean: learned force along the path, at the end.
        sd: standard deviation of its components.
        means: learned force on the arena at these moments.
        sds: standard deviation of its components.
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
        grid, path = ArenaGrid.over(Course.of(task), MAP_POINTS), visit.flight.path
        mean, sd = visit.belief.force(path)
        learned, spread = visit.belief.force(grid.places)
        maps = ForceMaps(
            learned=grid.field(lambda _: learned),
            truth=grid.field(lambda places: true_force(task, places)),
            sd=grid.lay(spread),
        )
        count = len(visit.moments) - 1
        picked = np.linspace(0, count, MOMENTS).round().astype(int)
        moments = [visit.moments[k] for k in picked]
        beliefs = [belief.force(grid.places) for belief in moments]
        means, sds = (
            np.stack([grid.lay(values) for values in part])
            for part in zip(*beliefs, strict=True)
        )
        times = np.array([belief.time for belief in moments])
        truth = true_force(task, path)
        return cls(maps, truth, mean, sd, times, means, sds)


@dataclasses.dataclass(frozen=True, eq=False)
class SwimmerFlights:
    """The flights of one swimmer.

    Attributes:
        flights: by the controller: the oracle, and each visit.
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
        adaptive: the controller.
        seed: seed of all noise.
        number: number of the swimmer; the first one is shown.
        visits: visits to the task, with the map kept.
        oracle: True to fly the oracle, too.

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
