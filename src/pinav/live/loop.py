"""The loop at the rig: read, learn, answer, remember; and replays of recordings."""

import dataclasses
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import msgspec
import numpy as np

from pinav.identification.tracks import Track, commands_of
from pinav.live.checkpoint import write_session
from pinav.live.messages import (
    VERSION,
    Bye,
    Command,
    Event,
    EventKind,
    Frame,
    FromPinav,
    Hello,
    Limits,
    Ready,
    State,
    encode,
)
from pinav.live.session import Session
from pinav.live.sources import AbstractSink, AbstractSource, LineBuffer, Reading

CHECKPOINT_EVERY = 1.0
"""Seconds between two checkpoints."""

WAIT = 0.1
"""Longest time for which the loop waits for a source [s]."""

LAGGING = 5
"""Frames that come at once from which on the lag is said."""

TABLE_LIMITS = Limits(frequency=10.0)
"""Limits of a robot whose table does not state them."""

LAG_EVERY = 5.0
"""Seconds between two events of a lag."""

Show = Callable[[FromPinav], None]
"""Takes everything that pinav says, in its order."""


@dataclasses.dataclass
class Loop:
    """A session between a source and a sink, with a checkpoint file if it is kept."""

    session: Session
    source: AbstractSource
    sink: AbstractSink
    show: Show
    checkpoint: Path | None = None
    limits: Limits = TABLE_LIMITS

    def __post_init__(self) -> None:
        self.buffer = LineBuffer()
        self.table: TableReader | None = None
        self.sniffed = False
        self.saved_at = self.lag_said_at = time.monotonic()
        self.saved_frames = self.session.counts.frames

    def run(self, until: Callable[[Session], bool] = lambda session: False) -> Session:
        """Read until the source or the rig ends, or a condition holds after a look."""
        try:
            while True:
                reading = self.source.read(WAIT)
                self.take(reading)
                if reading.ended or self.session.ended or until(self.session):
                    return self.session
        finally:
            self._save()

    def take(self, reading: Reading) -> None:
        """Learn from what a look at the source gave, and answer it."""
        if reading.fresh:
            self.buffer, self.table, self.sniffed = LineBuffer(), None, False
        if reading.text:
            self._say(self.session.event(EventKind.SOURCE, reading.text))
        if reading.data:
            arrived = time.perf_counter()
            self.buffer, lines = self.buffer.after(reading.data)
            self._learn([t for line in lines for t in self._translate(line)], arrived)
        self._save_when_due()

    def _learn(self, lines: list[bytes], arrived: float) -> None:
        if len(lines) > LAGGING:
            self._say_lag(len(lines))
        places = [place for place, line in enumerate(lines) if b'"frame"' in line]
        for place, line in enumerate(lines):
            outcome = self.session.after(line, newest=place in places[-1:])
            self.session = outcome.session
            self._say_all(outcome.answers, arrived)
            self._save_when_due()  # many lines may wait after a pause, or a kill
            if outcome.hang_up:
                self.source.hang_up()
                self.buffer = LineBuffer()
                break

    def _translate(self, line: bytes) -> Iterable[bytes]:
        """Lines of the protocol, of a line that may be one of a table."""
        if not self.sniffed:
            self.sniffed = True
            if not line.lstrip().startswith(b"{"):
                self.table = TableReader("table", self.limits)
        if self.table is None:
            return (line,)
        self.table, lines = self.table.after(line)
        return lines

    def _say_lag(self, frames: int) -> None:
        now = time.monotonic()
        if now - self.lag_said_at >= LAG_EVERY:
            self.lag_said_at = now
            text = f"{frames} lines came at once; only the newest is commanded for"
            self._say(self.session.event(EventKind.LAG, text))

    def _say_all(self, answers: Iterable[FromPinav], arrived: float) -> None:
        for answer in answers:
            if isinstance(answer, State):
                latency = 1e3 * (time.perf_counter() - arrived)
                answer = msgspec.structs.replace(answer, latency_ms=round(latency, 3))
            self._say(answer)

    def _say(self, answer: FromPinav) -> None:
        if isinstance(answer, Command | Ready | Event):
            self.sink.write(encode(answer))
        self.show(answer)

    def _save_when_due(self) -> None:
        if time.monotonic() - self.saved_at >= CHECKPOINT_EVERY:
            self._save()

    def _save(self) -> None:
        """Keep the session, where it has learned anything since it was kept last."""
        self.saved_at = time.monotonic()
        frames = self.session.counts.frames
        if self.checkpoint is not None and frames != self.saved_frames:
            write_session(self.checkpoint, self.session)
            self.saved_frames = frames


NAMES: Mapping[str, tuple[str, ...]] = {
    "t": ("t_s", "t", "time"),
    "x": ("x_um", "x"),
    "y": ("y_um", "y"),
    "seq": ("frame", "seq"),
    "frequency": ("freq_hz", "frequency"),
    "heading": ("alpha_rad", "heading"),
}
"""Columns of each quantity, the first one that a table has counts."""


@dataclasses.dataclass(frozen=True)
class TableReader:
    """Rows of a tracker's growing table of text become lines of the protocol.

    The columns are those of a tidy table (docs/recordings.md), y upwards; the first two
    rows say what the step is.
    A row that cannot be read is passed on as it is, for the session to refuse it.

    Attributes:
        places: column of each quantity; none before the header.
        rows: rows so far, used as number of the frame where the table has none.
    """

    session: str
    limits: Limits
    places: Mapping[str, int] | None = None
    first: bytes | None = None
    rows: int = 0
    greeted: bool = False

    def after(self, line: bytes) -> tuple["TableReader", list[bytes]]:
        """The reader and the lines of the protocol after a line of the table."""
        places = header_places(line)
        if places is not None:
            return dataclasses.replace(self, places=places, first=None), []
        if self.places is None:
            return self, [line]
        frame = self._frame(line)
        reader = dataclasses.replace(self, rows=self.rows + 1)
        if frame is None:
            return reader, [line]
        if self.greeted:
            return reader, [encode(frame).rstrip()]
        earlier = None if self.first is None else self._frame(self.first, self.rows - 1)
        if earlier is None or self.first is None or frame.t <= earlier.t:
            return dataclasses.replace(reader, first=line), []
        hello = Hello(
            version=VERSION,
            session=self.session,
            step=frame.t - earlier.t,
            limits=self.limits,
        )
        lines = [encode(message).rstrip() for message in (hello, earlier, frame)]
        return dataclasses.replace(reader, greeted=True, first=None), lines

    def _frame(self, line: bytes, row: int | None = None) -> Frame | None:
        assert self.places is not None
        cells = line.split(b",")
        values: dict[str, float] = {}
        for name, place in self.places.items():
            if place >= len(cells):
                return None
            try:
                values[name] = float(cells[place] or b"nan")
            except ValueError:
                return None
        here = {n: v if math.isfinite(v) else None for n, v in values.items()}
        time, number = here["t"], here.get("seq", self.rows if row is None else row)
        if time is None or number is None or number < 0:
            return None
        return Frame(
            seq=int(number),
            t=time,
            x=here["x"],
            y=here["y"],
            frequency=max(here.get("frequency") or 0.0, 0.0),
            heading=here.get("heading") or 0.0,
        )


def header_places(line: bytes) -> dict[str, int] | None:
    """The column of each quantity in a header; none in a line that is no header."""
    titles = [cell.strip().lower() for cell in line.decode(errors="replace").split(",")]
    places = {
        name: titles.index(next(title for title in names if title in titles))
        for name, names in NAMES.items()
        if set(names) & set(titles)
    }
    return places if {"t", "x", "y"} <= set(places) else None


def lines_of(track: Track, units: str) -> Iterator[bytes]:
    """Hello, frames and bye of a track, as lines without newlines."""
    steps = np.concatenate([np.diff(piece.times) for piece in track.pieces])
    fastest = max(float(commands_of(piece)[0].max()) for piece in track.pieces)
    yield encode(
        Hello(
            version=VERSION,
            session=track.name[:200],
            step=float(np.median(steps)),
            units=units,
            limits=Limits(frequency=max(fastest, 1e-3)),
            clock="of the recording",
        )
    ).rstrip()
    pieces = [(p.times, *p.states.T, *commands_of(p)) for p in track.pieces]
    columns = (np.concatenate(parts).tolist() for parts in zip(*pieces, strict=True))
    for seq, (t, x, y, frequency, heading) in enumerate(zip(*columns, strict=True)):
        frame = Frame(
            seq=seq, t=t, x=x, y=y, frequency=max(frequency, 0.0), heading=heading
        )
        yield encode(frame).rstrip()
    yield encode(Bye(reason="end of the recording")).rstrip()


def lines_in(path: Path) -> Iterator[bytes]:
    """The lines of a finished file in the protocol."""
    with open(path, "rb") as file:
        for line in file:
            if stripped := line.rstrip(b"\r\n"):
                yield stripped


def replay(
    session: Session, lines: Iterator[bytes], speed: float | None = None
) -> Iterator[tuple[FromPinav, float]]:
    """Answers to lines, each with its seconds; the clock only sets the pace."""
    begin, origin = time.monotonic(), None
    for line in lines:
        before = time.perf_counter()
        outcome = session.after(line)
        took = time.perf_counter() - before
        session = outcome.session
        for answer in outcome.answers:
            if speed is not None and isinstance(answer, State):
                origin = answer.t if origin is None else origin
                due = begin + (answer.t - origin) / speed
                time.sleep(max(due - time.monotonic(), 0.0))
            yield answer, took
