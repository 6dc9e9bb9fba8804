"""Results of `pinav navigate`: with a learned model, or learning on the way."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from pinav.navigation.adaptive.scores import FlightOutcome, judge_controllers
from pinav.navigation.adaptive.steering import AdaptiveController
from pinav.navigation.adaptive.swimmer import ShownFlight, SwimmerFlights
from pinav.navigation.maps import Course, ForceMaps
from pinav.navigation.suggestion import Suggestion
from pinav.navigation.trials.closed_loop import Episodes
from pinav.navigation.trials.metrics import Interval, Summary


class AbstractNavigation:
    """The result of a navigation."""


@dataclasses.dataclass(frozen=True, eq=False)
class PlanLattice:
    """The values of a plan, as they can be evaluated elsewhere.

    Attributes:
        values: fraction that is left of a time to go, on a lattice of velocities, where
            there is inertia, and positions.
        lower: first point of the lattice along each axis.
        spacing: of its points.
        scale: time in which a value falls to 1/e [T].
        ahead: time that the control looks ahead [T].
        horizon: time limit of the task [T].
    """

    values: Float[np.ndarray, "..."]
    lower: Float[np.ndarray, " axis"]
    spacing: Float[np.ndarray, " axis"]
    scale: float
    ahead: float
    horizon: float
    thrusts: Float[np.ndarray, "heading 2"]


@dataclasses.dataclass(frozen=True, eq=False)
class PlannedWay:
    """The plan on the learned force.

    Attributes:
        time: from the start, at rest, to the goal [T].
        route_time: the same along the planned route [T]; infinite if it does not
            arrive.
        unreachable: fraction of the arena from which the goal cannot be reached.
        times: time to go from rest on the arena [T]; infinite where there is no way.
    """

    time: float
    route_time: float
    unreachable: float
    route: Float[np.ndarray, "time dim"]
    times: Float[np.ndarray, "..."]
    lattice: PlanLattice | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class ComputingTimes:
    """Computing time of a command [s].

    Attributes:
        first: of the first one, with its compilation.
        median: of the later ones.
    """

    first: float
    median: float


@dataclasses.dataclass(frozen=True, eq=False)
class Navigation(AbstractNavigation):
    """Plans with a learned model, and with others, tried in closed loop.

    Attributes:
        truth: name of the system whose environment is the truth; none if not known.
        controllers: performance, by the model with which they plan.
        regret: arrival times over those with the truth, by the same.
        refused: reasons why there is no run with a model, by its name.
        computing: computing times of the controller with the learned model.
        units: units of the channels, and the order of the dynamics.
        delay: time from command to motion [T].
        step: time for which a command holds [T].
        episodes: closed loops, by the model with which the controller plans.
        maps: forces on the arena; none in space.
        suggestion: trajectory to record next; none where the fit tells of none.
    """

    truth: str | None
    plan: PlannedWay
    controllers: dict[str, Summary]
    regret: dict[str, Interval]
    refused: dict[str, str]
    computing: ComputingTimes
    units: dict[str, str]
    thrust: float
    delay: float
    step: float
    course: Course
    episodes: dict[str, Episodes]
    maps: ForceMaps | None = None
    suggestion: Suggestion | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class OnlineNavigation(AbstractNavigation):
    """Flights of swimmers that learn a force on the way.

    Attributes:
        position_noise: standard deviation of the observed positions [L].
        delay: time from command to thrust [T].
        time_limit: time when a flight is given up [T].
        own_limit: time limit of the task itself [T].
        step: time between two frames [T].
        prior: True where the first visit began with a fit.
        units: units of the channels, and the order of the dynamics.
        controllers: performance of the oracle, and of the visits.
        paths: true positions of each swimmer at the frames, by the controller [L].
        shown: first flight of the first swimmer.
    """

    task: str
    position_noise: float
    delay: float
    time_limit: float
    own_limit: float
    thrust: float
    step: float
    prior: bool
    units: dict[str, str]
    course: Course
    controllers: dict[str, FlightOutcome]
    paths: dict[str, tuple[Float[np.ndarray, "_ 2"], ...]]
    shown: ShownFlight

    @classmethod
    def of(
        cls,
        adaptive: AdaptiveController,
        swimmers: Sequence[SwimmerFlights],
        *,
        own_limit: float,
        units: Mapping[str, str],
    ) -> "OnlineNavigation":
        """The result of the flights of some swimmers."""
        task, shown = adaptive.task, swimmers[0].shown
        assert shown is not None
        flights = {
            name: [one.flights[name] for one in swimmers]
            for name in swimmers[0].flights
        }
        return cls(
            task=task.name,
            position_noise=task.sensor_noise,
            delay=task.delay,
            time_limit=task.time_limit,
            own_limit=own_limit,
            thrust=adaptive.thrust,
            step=task.step,
            prior=adaptive.known is not None,
            units=dict(units),
            course=Course.of(task),
            controllers=judge_controllers(flights, own_limit),
            paths={
                name: tuple(flight.path for flight in some)
                for name, some in flights.items()
            },
            shown=shown,
        )
