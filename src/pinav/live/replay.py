"""A finished recording, told as a rig would have told it, on its own clock."""

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pinav.identification.tracks import Track, commands_of
from pinav.live import messages
from pinav.live.session import Session


def lines_of(track: Track, units: str) -> Iterator[bytes]:
    """Hello, frames and bye of a track, as lines without newlines."""
    steps = np.concatenate([np.diff(piece.times) for piece in track.pieces])
    fastest = max(float(commands_of(piece)[0].max()) for piece in track.pieces)
    yield messages.encode(
        messages.Hello(
            version=messages.VERSION,
            session=track.name[:200],
            step=float(np.median(steps)),
            units=units,
            limits=messages.Limits(frequency=max(fastest, 1e-3)),
            clock="of the recording",
        )
    ).rstrip()
    pieces = [(p.times, *p.states.T, *commands_of(p)) for p in track.pieces]
    columns = (np.concatenate(parts).tolist() for parts in zip(*pieces, strict=True))
    for seq, (t, x, y, frequency, heading) in enumerate(zip(*columns, strict=True)):
        frame = messages.Frame(
            seq=seq, t=t, x=x, y=y, frequency=max(frequency, 0.0), heading=heading
        )
        yield messages.encode(frame).rstrip()
    yield messages.encode(messages.Bye(reason="end of the recording")).rstrip()


def lines_in(path: Path) -> Iterator[bytes]:
    """The lines of a finished file in the protocol."""
    with open(path, "rb") as file:
        for line in file:
            if stripped := line.rstrip(b"\r\n"):
                yield stripped


def replay(
    session: Session, lines: Iterator[bytes], speed: float | None = None
) -> Iterator[tuple[messages.FromPinav, float]]:
    """Answers to lines, each with its seconds; the clock only sets the pace."""
    begin, origin = time.monotonic(), None
    for line in lines:
        before = time.perf_counter()
        outcome = session.after(line)
        took = time.perf_counter() - before
        session = outcome.session
        for answer in outcome.answers:
            if speed is not None and isinstance(answer, messages.State):
                origin = answer.t if origin is None else origin
                due = begin + (answer.t - origin) / speed
                time.sleep(max(due - time.monotonic(), 0.0))
            yield answer, took
