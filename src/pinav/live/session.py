"""`Session`: what is done with each line of a rig, as a pure function of a value.

A file that grows, a socket, standard input and a replay give their lines to the same
code; nothing here knows where a line came from, what the clock on the wall says, or
where answers go.
"""

import dataclasses
import hmac
import math

import msgspec

from pinav.live.estimators import AbstractEstimator, AbstractPilot, Advice, Intent
from pinav.live.messages import (
    VERSION,
    Bye,
    Command,
    Event,
    EventKind,
    Frame,
    FromPinav,
    Hello,
    Mode,
    Ready,
    RefusedLine,
    State,
    decode,
)

REFUSED_IN_A_ROW = 20
"""So many lines in a row that are no messages end a connection."""

LONGEST_STEP = 5
"""Steps between two frames beyond which the clock has jumped."""

BLIND_STEPS = 3
"""Steps, beside the delay, after which a robot that is not seen is stopped."""

VALID_STEPS = 5
"""Steps for which a command holds, beside the delay, unless another one follows."""

GATE = 5.0
"""Standard deviations beyond which a robot that was lost is doubted to be the same."""

GATE_IN_SIGHT = 15.0
"""The same for one that was not: trackers take another particle for it."""


@dataclasses.dataclass(frozen=True)
class Counts:
    """Numbers of frames (lost ones included), refused lines, and other events.

    Attributes:
        frames: frames that were learned from, lost ones included.
        repeated: frames whose number did not grow.
        reacquired: new states after the robot was lost.
    """

    frames: int = 0
    refused: int = 0
    repeated: int = 0
    jumps: int = 0
    lost: int = 0
    reacquired: int = 0
    commands: int = 0

    def plus(self, name: str) -> "Counts":
        """One more of something."""
        return dataclasses.replace(self, **{name: getattr(self, name) + 1})


@dataclasses.dataclass(frozen=True)
class Session:
    """All that a session remembers.

    Attributes:
        blind: frames in a row without a position.
        doubted: position far from where a lost robot was expected.
        repeating: the last line was a frame that had been there before.
        resumed_at: last frame that was learned from by a process before this one.
        known_in: unit of length of a drive learned in an earlier session; empty without
            one.
    """

    estimator: AbstractEstimator
    pilot: AbstractPilot | None = None
    token: str = ""
    hello: Hello | None = None
    mode: Mode = Mode.WAITING
    last: Frame | None = None
    blind: int = 0
    doubted: Frame | None = None
    refused_in_row: int = 0
    ended: bool = False
    repeating: bool = False
    resumed_at: int | None = None
    counts: Counts = Counts()
    known_in: str = ""

    def after(self, line: bytes, *, newest: bool = True) -> "SessionOutcome":
        """The session after a line, and answers; commands to the `newest` frame."""
        try:
            message = decode(line)
        except RefusedLine as error:
            return self._refuse(str(error))
        session = dataclasses.replace(self, refused_in_row=0)
        if isinstance(message, Hello):
            return session._greet(message)
        if session.hello is None:
            return self._refuse("the first line must be a hello")
        if isinstance(message, Bye):
            return session._end(message)
        return session._see(message, newest=newest)

    def event(self, kind: EventKind, text: str) -> Event:
        """An event at the time of the last frame."""
        return Event(t=None if self.last is None else self.last.t, kind=kind, text=text)

    def _refuse(self, reason: str) -> "SessionOutcome":
        """Skip a line; say so for the first of a row, and end where a row is long."""
        in_row = self.refused_in_row + 1
        session = dataclasses.replace(
            self, refused_in_row=in_row, counts=self.counts.plus("refused")
        )
        if in_row == 1:
            return SessionOutcome(
                session, (self.event(EventKind.REFUSED, reason[:200]),)
            )
        if in_row % REFUSED_IN_A_ROW == 0:
            text = f"{in_row} lines in a row were no messages"
            event = self.event(EventKind.REFUSED, text)
            return SessionOutcome(session, (event,), hang_up=True)
        return SessionOutcome(session)

    def _greet(self, hello: Hello) -> "SessionOutcome":
        """Begin, go on after a new connection, or begin anew with what was learned."""
        if hello.version != VERSION:
            text = f"protocol version {hello.version}, expected {VERSION}"
            return dataclasses.replace(self._refuse(text), hang_up=True)
        if not hmac.compare_digest(hello.token.encode(), self.token.encode()):
            return dataclasses.replace(self._refuse("wrong token"), hang_up=True)
        if self.known_in not in ("", hello.units):
            text = f"lengths in {hello.units}, expected {self.known_in} of --prior"
            return dataclasses.replace(self._refuse(text), hang_up=True)
        same = self.hello is not None and self.hello.session == hello.session
        last = self.last if same else None
        session = dataclasses.replace(self, hello=hello, last=last, ended=False)
        if not same:
            session = dataclasses.replace(session, blind=0, doubted=None)
        if self.mode is Mode.STOPPED:
            session = dataclasses.replace(session, mode=Mode.WAITING)
        resumed_at = None if last is None else last.seq
        ready = Ready(version=VERSION, session=hello.session, resumed_at=resumed_at)
        return SessionOutcome(session, (ready,))

    def _end(self, bye: Bye) -> "SessionOutcome":
        session = dataclasses.replace(self, mode=Mode.STOPPED, ended=True)
        text = f"the rig has ended the session: {bye.reason or 'no reason given'}"
        return SessionOutcome(session, (self.event(EventKind.BYE, text),))

    def _see(self, frame: Frame, *, newest: bool) -> "SessionOutcome":
        if self.last is not None and frame.seq <= self.last.seq:
            counts = self.counts.plus("repeated")
            session = dataclasses.replace(self, counts=counts, repeating=True)
            text = f"frame {frame.seq} after frame {self.last.seq}: ignored"
            event = self.event(EventKind.REPEATED, text)
            return SessionOutcome(session, () if self.repeating else (event,))
        session, events = self._learn(frame)
        session, answers = session._act(newest=newest)
        return SessionOutcome(session, (*events, *answers))

    def _learn(self, frame: Frame) -> tuple["Session", tuple[Event, ...]]:
        counts = self.counts.plus("frames")
        session = dataclasses.replace(self, last=frame, counts=counts, repeating=False)
        if reason := self._jump_to(frame):
            session = session._begin_anew(frame, "jumps")
            return session, (session.event(EventKind.JUMP, reason),)
        if not frame.observed:
            session = dataclasses.replace(
                session,
                estimator=self.estimator.after(frame),
                blind=self.blind + 1,
                counts=counts.plus("lost"),
            )
            text = "the robot is not seen"
            lost = (session.event(EventKind.LOST, text),) if not self.blind else ()
            return session, lost
        if self._is_far(frame, GATE if self.blind else GATE_IN_SIGHT):
            return session._doubt(frame, self.doubted)
        estimator = self.estimator.after(frame)
        return (
            dataclasses.replace(session, estimator=estimator, blind=0, doubted=None),
            (),
        )

    def _jump_to(self, frame: Frame) -> str:
        """Reason why a frame does not continue the last one; empty where it does."""
        if self.last is None:
            learned = self.counts.frames or self.known_in
            return "the session has begun anew" if learned else ""
        if frame.t <= self.last.t:
            return f"the clock went back by {self.last.t - frame.t:.6g} s"
        assert self.hello is not None
        if frame.t - self.last.t > LONGEST_STEP * self.hello.step * (1 + 1e-6):
            return f"the clock went forward by {frame.t - self.last.t:.6g} s"
        return ""

    def _begin_anew(self, frame: Frame, name: str) -> "Session":
        """A new state; what was learned of drive and surroundings is kept."""
        return dataclasses.replace(
            self,
            estimator=self.estimator.restart(frame),
            blind=0 if frame.observed else 1,
            doubted=None,
            counts=self.counts.plus(name),
        )

    def _is_far(self, frame: Frame, gate: float) -> bool:
        """True if a position is so many sd from the expected one."""
        expected = self.estimator.whereabouts(frame.t)
        if expected is None or expected.sd is None:
            return False
        return _distance(frame, expected.position) > gate * expected.sd

    def _doubt(
        self, frame: Frame, other: Frame | None
    ) -> tuple["Session", tuple[Event, ...]]:
        """Wait for a second position that agrees; then it is the robot's."""
        expected = self.estimator.whereabouts(frame.t)
        assert expected is not None
        assert expected.sd is not None
        assert frame.x is not None
        assert frame.y is not None
        if other is not None and other.x is not None and other.y is not None:
            apart = _distance(frame, (other.x, other.y))
            if apart <= GATE * expected.sd:
                session = self._begin_anew(frame, "reacquired")
                place = f"({frame.x:.6g}, {frame.y:.6g})"
                text = f"the robot is seen again, elsewhere, at {place}"
                return session, (session.event(EventKind.REACQUIRED, text),)
        unseen = msgspec.structs.replace(frame, x=None, y=None, sd=None)
        return (
            dataclasses.replace(
                self,
                estimator=self.estimator.after(unseen),
                blind=self.blind + 1,
                doubted=frame,
            ),
            (),
        )

    def _act(self, *, newest: bool) -> tuple["Session", tuple[FromPinav, ...]]:
        """The state after a frame, a command where one is due, and the mode."""
        assert self.last is not None
        pilot, advice = self.pilot, None
        mode = Mode.IDENTIFYING if self.estimator.driven else Mode.WAITING
        if pilot is not None and self.mode is not Mode.STOPPED and newest:
            pilot, advice = self._advice(pilot)
            mode = advice.intent.mode
        elif pilot is not None:
            mode = self.mode
        session = dataclasses.replace(self, pilot=pilot, mode=mode)
        answers: list[FromPinav] = []
        if mode is not self.mode:
            kind = advice.intent.kind if advice else EventKind.MODE
            text = f"{mode}: {advice.intent.reason}" if advice else str(mode)
            answers.append(session.event(kind, text))
        if advice is not None:
            session = dataclasses.replace(session, counts=self.counts.plus("commands"))
            answers.append(session._command(advice))
        answers.append(session._state(advice))
        return session, tuple(answers)

    def _advice(self, pilot: AbstractPilot) -> tuple[AbstractPilot, Advice]:
        """The pilot's advice; to stand still where the robot is not seen."""
        assert self.last is not None
        assert self.hello is not None
        if self.blind > BLIND_STEPS + self._delay() / self.hello.step:
            return pilot, Advice(0.0, self.last.heading, Intent.BLIND)
        return pilot.after(self.estimator, self.hello, self.last.t)

    def _delay(self) -> float:
        drive = self.estimator.drive()
        return 0.0 if drive is None else drive.delay

    def _command(self, advice: Advice) -> Command:
        assert self.last is not None
        assert self.hello is not None
        frequency = min(max(advice.frequency, 0.0), self.hello.limits.frequency)
        return Command(
            seq=self.last.seq,
            for_t=self.last.t,
            frequency=frequency if math.isfinite(advice.heading) else 0.0,
            heading=advice.heading if math.isfinite(advice.heading) else 0.0,
            valid_until=self.last.t + VALID_STEPS * self.hello.step,
        )

    def _state(self, advice: Advice | None) -> State:
        assert self.last is not None
        where = self.estimator.whereabouts(self.last.t)
        x, y = (None, None) if where is None else where.position
        drive = self.estimator.drive()
        known = {} if drive is None else {name: getattr(drive, name) for name in TOLD}
        return State(
            seq=self.last.seq,
            t=self.last.t,
            mode=self.mode,
            x=x,
            y=y,
            sd=None if where is None else where.sd,
            time_to_go=None if advice is None else advice.time_to_go,
            **known,
        )


TOLD = ("delay", "gain", "gain_sd", "offset", "drift")
"""Numbers of the drive that a state tells."""


@dataclasses.dataclass(frozen=True)
class SessionOutcome:
    """The next session, and answers for the rig and for people, in order."""

    session: Session
    answers: tuple[FromPinav, ...] = ()
    hang_up: bool = False


def _distance(frame: Frame, position: tuple[float, float]) -> float:
    assert frame.x is not None
    assert frame.y is not None
    return math.hypot(frame.x - position[0], frame.y - position[1])
