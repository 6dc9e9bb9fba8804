"""The results of `pinav navigate`, as `metrics.json` holds them."""

import msgspec

from pinav.commands.cells import Row
from pinav.navigation import Summary


class IntervalRow(Row, frozen=True):
    """A value with its 95 % interval; None stands for infinity.

    Attributes:
        value: the estimate.
        lower: end of the interval.
        upper: end of the interval.
    """

    value: float | None
    lower: float | None
    upper: float | None

    def percent(self) -> str:
        """The interval of a proportion, in words."""
        parts = (self.value, self.lower, self.upper)
        value, lower, upper = (100 * (part or 0.0) for part in parts)
        return f"{value:.0f} % ({lower:.0f}–{upper:.0f})"

    def ratio(self) -> str:
        """The interval of a ratio, in words."""
        parts = (self.value, self.lower, self.upper)
        value, lower, upper = ("∞" if p is None else f"{p:.3f}" for p in parts)
        return f"{value} ({lower}–{upper})"


class ArrivalRow(Row, frozen=True):
    """Arrival times of those that arrived [T]; None where nobody did.

    Attributes:
        low: 5 % quantile.
        median: of them.
        high: 95 % quantile.
    """

    low: float | None
    median: float | None
    high: float | None


class ControllerRow(Row, frozen=True):
    """The performance of a controller in closed loop.

    Attributes:
        runs: number of them.
        success: proportion that arrived without a violation.
        violation: proportion that entered a forbidden place.
        arrival: times of those that arrived.
        efficiency: straight distance over length of the path.
        clearance: least distance from forbidden places [L].
        effort: integral of the squared frequency.
        turning: sum of the changes of heading [rad].
    """

    runs: int
    success: IntervalRow
    violation: IntervalRow
    arrival: ArrivalRow
    efficiency: float | None
    clearance: float | None
    effort: float | None = None
    turning: float | None = None

    @classmethod
    def of_summary(cls, summary: Summary) -> "ControllerRow":
        """The row of a summary."""
        names = ArrivalRow.__struct_fields__
        arrival = dict(zip(names, summary.arrival, strict=True))
        return cls.of(summary, runs=summary.count, arrival=arrival)


class PlanRow(msgspec.Struct, frozen=True):
    """The plan on the learned force.

    Attributes:
        time: from the start, at rest, to the goal [T].
        route_time: the same along the planned route [T]; None if it does not arrive.
        unreachable: fraction of the arena from which the goal cannot be reached.
    """

    time: float
    route_time: float | None
    unreachable: float


class StepTimes(msgspec.Struct, frozen=True):
    """Computing time of a command [s].

    Attributes:
        first: of the first one, with its compilation.
        median: of the later ones.
    """

    first: float
    median: float


class SuggestionRow(msgspec.Struct, frozen=True, omit_defaults=True):
    """The trajectory that should be recorded next.

    Attributes:
        sd: standard deviation of the force along the route now.
        sd_after: expected after it.
        sd_after_random: expected after a random one; None where all leave the arena.
        start: place of release [L].
        duration: [T].
    """

    sd: float
    sd_after: float
    sd_after_random: float | None
    start: tuple[float, float] | None = None
    duration: float | None = None


class NavigationMetrics(msgspec.Struct, frozen=True, omit_defaults=True):
    """The numbers of a navigation.

    Attributes:
        truth: name of the system whose environment is the truth; None if not known.
        plan: on the learned force.
        controllers: performance by the model with which they plan.
        regret: arrival times over those with the truth.
        refused: reasons why there is no run with a model.
        step: computing times.
        units: of the channels.
        order: of the dynamics in time.
        force: unit of a force, where the mobility makes a velocity of it.
        thrust: greatest thrust.
        delay: from command to motion [T].
        suggestion: of the next trajectory.
    """

    truth: str | None
    plan: PlanRow
    controllers: dict[str, ControllerRow]
    regret: dict[str, IntervalRow]
    refused: dict[str, str]
    step: StepTimes
    units: dict[str, str] = {}
    order: int = 2
    force: str = "1"
    thrust: float = 1.0
    delay: float = 0.0
    suggestion: SuggestionRow | None = None
