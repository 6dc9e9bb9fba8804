"""Sessions with an estimator that needs no numerical work, for the state machine."""

import dataclasses
import itertools

from pinav.identification.running.forecast import DriveEstimate
from pinav.live import estimators
from pinav.live.messages import VERSION, Command, Event, Frame, Hello, Limits, encode
from pinav.live.session import Session


class LastPosition(estimators.AbstractEstimator):
    """Believes the last position, and remembers what it was told."""

    frames: tuple[Frame, ...] = ()
    restarts: tuple[int, ...] = ()
    sd: float = 1.0

    @property
    def driven(self):
        return any(frame.frequency > 0 for frame in self.frames)

    def after(self, frame):
        return dataclasses.replace(self, frames=(*self.frames, frame))

    def restart(self, frame):
        restarts = (*self.restarts, frame.seq)
        return dataclasses.replace(
            self, frames=(*self.frames, frame), restarts=restarts
        )

    def whereabouts(self, time):
        seen = [frame for frame in self.frames if frame.observed]
        return (
            estimators.Whereabouts((seen[-1].x, seen[-1].y), self.sd) if seen else None
        )

    def drive(self):
        return DriveEstimate(0.2, 1.0, 0.0, 0.0, (0.0, 0.0))


class Follow(estimators.AbstractPilot):
    """Always advises the same."""

    intent: estimators.Intent = estimators.Intent.STEER
    frequency: float = 1.0

    def after(self, estimator, hello, time):
        return self, estimators.Advice(self.frequency, 0.5, self.intent)

    def resume(self, earlier):
        return self


HELLO = Hello(version=VERSION, session="a", step=0.1, limits=Limits(frequency=3.0))


def line(message):
    return encode(message).rstrip()


def frame_line(seq, t=None, x=0.0, y=0.0, **more):
    return line(Frame(seq=seq, t=0.1 * seq if t is None else t, x=x, y=y, **more))


def feed(session, lines):
    """The session after some lines, and all answers."""
    answers = []
    for one in lines:
        outcome = session.after(one)
        session = outcome.session
        answers += outcome.answers
    return session, answers


def begun(**fields):
    return Session(LastPosition(), **fields).after(line(HELLO)).session


def steer(session, robot):
    """Steer a robot: after each frame its place, the session and what happened."""
    command = (0.0, 0.0)
    for seq in itertools.count():
        x, y = robot.seen()
        more = {"frequency": command[0], "heading": command[1]}
        outcome = session.after(frame_line(seq, t=robot.t, x=x, y=y, **more))
        session = outcome.session
        robot.move(*command)
        for answer in outcome.answers:
            if isinstance(answer, Command):
                command = answer.frequency, answer.heading
        events = [answer for answer in outcome.answers if isinstance(answer, Event)]
        yield (robot.x, robot.y), session, events
