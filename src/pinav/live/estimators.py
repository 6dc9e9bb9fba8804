"""Estimators and pilots as a session asks them, and the drive of a robot."""

import abc
import dataclasses
import enum
import math

import equinox as eqx
import numpy as np

from pinav.identification.running import RunningFit
from pinav.identification.running.forecast import DriveEstimate, estimate, locate
from pinav.live.messages import EventKind, Frame, Hello, Mode, Point


@dataclasses.dataclass(frozen=True)
class Whereabouts:
    """Believed position of the robot; sd of a coordinate [L], none where unknown."""

    position: Point
    sd: float | None


class AbstractEstimator(eqx.Module):
    """A belief about the robot, as a value."""

    @property
    @abc.abstractmethod
    def driven(self) -> bool:
        """True if the robot has been driven since the session began."""

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
    def drive(self) -> DriveEstimate | None:
        """The numbers of the drive; none before anything is known of it."""


class Intent(enum.Enum):
    """Action of a pilot: the mode of its session, the reason, and the kind of event."""

    PROBE = Mode.IDENTIFYING, "learning how the robot answers", EventKind.MODE
    STEER = Mode.STEERING, "on the way to the goal", EventKind.MODE
    ARRIVED = Mode.HOLDING, "the goal is reached", EventKind.ARRIVED
    AVOID = Mode.STEERING, "a forbidden place is near", EventKind.SAFETY
    BLIND = Mode.HOLDING, "the robot has not been seen for too long", EventKind.MODE
    UNREACHABLE = Mode.HOLDING, "no way to the goal is known", EventKind.UNREACHABLE
    STALLED = (
        Mode.IDENTIFYING,
        "the goal comes no nearer, moving about to learn more",
        EventKind.STALLED,
    )
    GIVE_UP = (
        Mode.STOPPED,
        "the goal has come no nearer for too long",
        EventKind.STALLED,
    )

    def __init__(self, mode: Mode, reason: str, kind: EventKind) -> None:
        self.mode, self.reason, self.kind = mode, reason, kind


@dataclasses.dataclass(frozen=True)
class Advice:
    """An advised command, and the time to the goal [s]; none where unknown."""

    frequency: float
    heading: float
    intent: Intent
    time_to_go: float | None = None


class AbstractPilot(eqx.Module):
    """A pilot to a goal, as a value."""

    @abc.abstractmethod
    def after(
        self, estimator: AbstractEstimator, hello: Hello, time: float
    ) -> tuple["AbstractPilot", Advice]:
        """The pilot after a frame at `time` [s], and what it advises."""

    @abc.abstractmethod
    def resume(self, earlier: "AbstractPilot") -> "AbstractPilot":
        """The pilot of these settings that remembers what an earlier one does."""


class DriveEstimator(AbstractEstimator):
    """Gain, heading offset, response, delay and drift of a robot, by `RunningFit`.

    Attributes:
        last: last seen position, its time and standard deviation; NaN before the first.
    """

    fit: RunningFit = eqx.field(default_factory=RunningFit.begin)
    last: np.ndarray = eqx.field(default_factory=lambda: np.full(4, np.nan))
    known: DriveEstimate | None = None

    @property
    def driven(self) -> bool:
        return self.fit.since is not None

    def after(self, frame: Frame) -> "DriveEstimator":
        fit = self.fit.after(*_parts(frame))
        known = self.known if fit.bank is self.fit.bank else estimate(fit)
        return DriveEstimator(fit, self._last(frame), known)

    def restart(self, frame: Frame) -> "DriveEstimator":
        fit = self.fit.restart(*_parts(frame))
        nowhere = DriveEstimator(fit, known=self.known)
        return dataclasses.replace(nowhere, last=nowhere._last(frame))

    def whereabouts(self, time: float) -> Whereabouts | None:
        """From the closed blocks, and from the last position if it is of this time."""
        x, y, seen_at, sd = (float(value) for value in self.last)
        if math.isnan(x):
            return None
        jitter = self.fit.jitter if math.isnan(sd) else sd**2
        ahead = locate(self.fit, time)
        if ahead is None:
            return Whereabouts((x, y), self._sd_without_blocks(jitter, time - seen_at))
        mean, variance = ahead.displacement[0], ahead.variance[0]
        if seen_at == time:
            part = variance / (variance + jitter + 1e-300)
            mean = mean + part * (np.array([x, y]) - mean)
            variance = variance * (1 - part)
        else:
            variance = variance + jitter
        place = (float(mean[0]), float(mean[1]))
        return Whereabouts(place, float(np.sqrt(variance.mean())))

    def seen_at(self, time: float) -> Point | None:
        """The position that was seen at a time [s]; none if the last one is older."""
        x, y, seen_at, _ = (float(value) for value in self.last)
        return (x, y) if seen_at == time else None

    def _sd_without_blocks(self, jitter: float, elapsed: float) -> float | None:
        """The last position's sd before a block is closed; none if unknown."""
        if elapsed == 0:
            return math.sqrt(jitter) if jitter > 0 else None
        if self.known is None:
            return None
        return math.sqrt(jitter) + self.known.gain * self.fit.fastest * elapsed

    def drive(self) -> DriveEstimate | None:
        return self.known

    def _last(self, frame: Frame) -> np.ndarray:
        if frame.x is None or frame.y is None:
            return self.last
        sd = np.nan if frame.sd is None else frame.sd
        return np.array([frame.x, frame.y, frame.t, sd])


def _parts(frame: Frame) -> tuple[float, tuple[float, float] | None, float, float]:
    observed = None if frame.x is None or frame.y is None else (frame.x, frame.y)
    return frame.t, observed, frame.frequency, frame.heading
