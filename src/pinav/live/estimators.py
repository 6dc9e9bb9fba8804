"""What a session asks of what estimates the robot, and of what steers it."""

import abc
import dataclasses
import enum

import equinox as eqx

from pinav.live.messages import Frame, Hello, Point


@dataclasses.dataclass(frozen=True)
class Whereabouts:
    """Where the robot is believed to be.

    Attributes:
        position: [L].
        sd: standard deviation of either coordinate [L]; none where it is not known.
    """

    position: Point
    sd: float | None


@dataclasses.dataclass(frozen=True)
class Drive:
    """What is known of drive and surroundings; none where it is not.

    Attributes:
        delay: from command to motion [s].
        gain: speed at 1 Hz and small frequencies [L per cycle].
        gain_sd: its standard deviation [L per cycle].
        offset: angle from the commanded heading to the motion [rad].
        drift: velocity without command [L/s].
        force: at the position.
        force_sd: of either component.
    """

    delay: float | None = None
    gain: float | None = None
    gain_sd: float | None = None
    offset: float | None = None
    drift: Point | None = None
    force: Point | None = None
    force_sd: float | None = None


class AbstractEstimator(eqx.Module):
    """A belief about the robot, as a value."""

    @property
    @abc.abstractmethod
    def driven(self) -> bool:
        """Whether the robot has been driven since the session began."""

    @abc.abstractmethod
    def after(self, frame: Frame) -> "AbstractEstimator":
        """The belief that knows a frame, which is later than all before it."""

    @abc.abstractmethod
    def restart(self, frame: Frame) -> "AbstractEstimator":
        """The belief with a new state at a frame; nothing is learned across it."""

    @abc.abstractmethod
    def whereabouts(self, time: float) -> Whereabouts | None:
        """The position at a time [s], not before the last frame; none if unknown."""

    @abc.abstractmethod
    def drive(self) -> Drive:
        """What is known of drive and surroundings."""


class Intent(enum.Enum):
    """What a pilot does, and why.

    Attributes:
        PROBE: move about, to learn how the robot answers.
        STEER: go on to the goal.
        ARRIVED: stand still, the goal is reached.
        AVOID: do not go on, a forbidden place is near.
        BLIND: stand still, the robot has not been seen for too long.
        UNREACHABLE: stand still, no way is known.
        STALLED: probe, because the goal has come no nearer for long.
        GIVE_UP: stop, because probing did not help.
    """

    PROBE = "probe"
    STEER = "steer"
    ARRIVED = "arrived"
    AVOID = "avoid"
    BLIND = "blind"
    UNREACHABLE = "unreachable"
    STALLED = "stalled"
    GIVE_UP = "give up"


@dataclasses.dataclass(frozen=True)
class Advice:
    """A command that a pilot advises.

    Attributes:
        frequency: [Hz].
        heading: [rad].
        intent: what it is for.
        time_to_go: to the goal [s]; none where it is not known.
    """

    frequency: float
    heading: float
    intent: Intent
    time_to_go: float | None = None


class AbstractPilot(eqx.Module):
    """What steers to a goal, as a value."""

    @abc.abstractmethod
    def after(
        self, estimator: AbstractEstimator, hello: Hello, time: float
    ) -> tuple["AbstractPilot", Advice]:
        """The pilot after a frame at `time` [s], and what it advises."""

    @abc.abstractmethod
    def resume(self, earlier: "AbstractPilot") -> "AbstractPilot":
        """The pilot of these settings that remembers what an earlier one does."""
