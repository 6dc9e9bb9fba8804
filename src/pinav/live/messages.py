"""The protocol: what a rig says to pinav, and pinav to a rig; docs/live.md.

One JSON object a line, UTF-8, at most `LONGEST` bytes. Fields that are not known are
ignored, so that later versions may add some; numbers that are not finite are refused.
Nothing that is read is ever executed.
"""

import enum
from typing import Annotated

import msgspec
from msgspec import Meta

VERSION = 1
"""Version of the protocol; another one is refused."""

LONGEST = 64 * 1024
"""Bytes of the longest line."""

GREATEST = 1e12
"""Greatest size of a number: beyond it squares lose their digits."""

Real = Annotated[float, Meta(ge=-GREATEST, le=GREATEST)]
"""A finite number; NaN and infinity are no JSON and refused."""

Size = Annotated[float, Meta(ge=0.0, le=GREATEST)]
"""A finite number that is not negative."""

Step = Annotated[float, Meta(gt=0.0, le=GREATEST)]
"""A finite number above zero."""

Count = Annotated[int, Meta(ge=0, le=2**53)]
"""A number of something; JSON's readers are exact up to here."""

Text = Annotated[str, Meta(max_length=200)]
"""A name or a sentence."""

Point = tuple[Real, Real]
"""Two coordinates, or components along x and y."""


class Mode(enum.StrEnum):
    """Activity of pinav.

    Attributes:
        WAITING: no robot that was driven has been seen yet.
        IDENTIFYING: the drive is not known well enough to steer by.
        STEERING: commands lead to the goal.
        HOLDING: the command is to stand still; an event says why.
        STOPPED: nothing is commanded any more.
    """

    WAITING = "waiting"
    IDENTIFYING = "identifying"
    STEERING = "steering"
    HOLDING = "holding"
    STOPPED = "stopped"


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """Limits of coils and robot.

    Attributes:
        frequency: greatest frequency [Hz].
        turning_rate: greatest rate of the heading [rad/s]; none where it turns at once.
    """

    frequency: Step
    turning_rate: Step | None = None


class Hello(msgspec.Struct, frozen=True, kw_only=True, tag="hello"):
    """The first line of a rig, and again after it has started anew.

    Attributes:
        version: of the protocol.
        session: name of the session; a new name begins with a new robot or clock.
        step: interval of frames [s].
        units: of lengths, such as um.
        limits: what may be commanded.
        clock: what times count from, in words.
        token: the shared secret, where pinav asks for one.
    """

    version: Annotated[int, Meta(ge=1, le=10**6)]
    session: Text
    step: Step
    units: Annotated[str, Meta(max_length=20)] = "um"
    limits: Limits
    clock: Text = ""
    token: Text = ""


class Frame(msgspec.Struct, frozen=True, kw_only=True, tag="frame"):
    """One image of the robot.

    Attributes:
        seq: number of the frame; grows by one or more.
        t: its time [s].
        x: position along x [L]; none where the robot was not seen.
        y: position along y, upwards [L].
        sd: standard deviation of either coordinate [L]; none where it is not known.
        frequency: what is applied from `t` on [Hz].
        heading: azimuth of the commanded motion, applied from `t` on [rad].
    """

    seq: Count
    t: Real
    x: Real | None
    y: Real | None
    sd: Size | None = None
    frequency: Size = 0.0
    heading: Real = 0.0

    @property
    def observed(self) -> bool:
        """Whether both coordinates were measured."""
        return self.x is not None and self.y is not None


class Bye(msgspec.Struct, frozen=True, kw_only=True, tag="bye"):
    """The last line of a rig.

    Attributes:
        reason: in words.
    """

    reason: Text = ""


class Ready(msgspec.Struct, frozen=True, kw_only=True, tag="ready"):
    """The answer to `Hello`.

    Attributes:
        version: of the protocol.
        session: that of the rig.
        resumed_at: last frame that was learned from before; none in a new session.
    """

    version: int
    session: str
    resumed_at: int | None = None


class Command(msgspec.Struct, frozen=True, kw_only=True, tag="command"):
    """A command that the rig should apply at once.

    Attributes:
        seq: of the frame that it answers.
        for_t: time from which it is meant to hold [s].
        frequency: [Hz].
        heading: [rad].
        valid_until: when the rig stops by itself unless it has heard more [s].
    """

    seq: int
    for_t: float
    frequency: float
    heading: float
    valid_until: float


class State(msgspec.Struct, frozen=True, kw_only=True, tag="state"):
    """Beliefs after a frame; none stands where something is not known.

    Attributes:
        seq: of the frame.
        t: its time [s].
        mode: what pinav is doing.
        x: position [L].
        y: position, upwards [L].
        sd: standard deviation of either coordinate [L].
        delay: from command to motion [s].
        gain: speed at 1 Hz and small frequencies [L per cycle].
        gain_sd: its standard deviation [L per cycle].
        offset: angle from the commanded heading to the motion [rad].
        drift: velocity without command [L/s].
        force: at the position: an acceleration, or a velocity at mobility 1.
        force_sd: of either component.
        time_to_go: to the goal [s].
        latency_ms: from reading the frame to this line; none in a replay.
    """

    seq: int
    t: float
    mode: Mode
    x: float | None = None
    y: float | None = None
    sd: float | None = None
    delay: float | None = None
    gain: float | None = None
    gain_sd: float | None = None
    offset: float | None = None
    drift: Point | None = None
    force: Point | None = None
    force_sd: float | None = None
    time_to_go: float | None = None
    latency_ms: float | None = None


class EventKind(enum.StrEnum):
    """Kinds of events; docs/live.md describes the reactions of pinav."""

    MODE = "mode"
    REFUSED = "refused"
    REPEATED = "repeated"
    JUMP = "jump"
    LOST = "lost"
    REACQUIRED = "reacquired"
    SOURCE = "source"
    LAG = "lag"
    ARRIVED = "arrived"
    STALLED = "stalled"
    UNREACHABLE = "unreachable"
    SAFETY = "safety"
    BYE = "bye"


class Event(msgspec.Struct, frozen=True, kw_only=True, tag="event"):
    """Something that a person should know.

    Attributes:
        t: time of the last frame [s]; none before the first.
        kind: of the event.
        text: a sentence.
    """

    t: float | None
    kind: EventKind
    text: str


FromRig = Hello | Frame | Bye
"""Lines that pinav reads."""

FromPinav = Ready | Command | State | Event
"""Lines that pinav writes."""


class RefusedLine(ValueError):
    """A line that is no message of a rig; the message says why."""


_DECODER = msgspec.json.Decoder(FromRig)
_ENCODER = msgspec.json.Encoder()


def decode(line: bytes) -> FromRig:
    """The message in a line, without its newline.

    Raises:
        RefusedLine: it is too long, no JSON, or no message of a rig.
    """
    if len(line) > LONGEST:
        raise RefusedLine(f"longer than {LONGEST} bytes")
    try:
        return _DECODER.decode(line)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise RefusedLine(str(error) or type(error).__name__) from error


def encode(message: FromRig | FromPinav) -> bytes:
    """The line of a message, with its newline."""
    return _ENCODER.encode(message) + b"\n"


def schema() -> bytes:
    """The JSON Schema of every line, as it is kept in `docs/live.schema.json`."""
    (both,), components = msgspec.json.schema_components(
        [FromRig | FromPinav], ref_template="#/$defs/{name}"
    )
    document = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"Lines between a rig and pinav live, version {VERSION}",
        **both,
        "$defs": components,
    }
    return msgspec.json.format(msgspec.json.encode(document), indent=2) + b"\n"
