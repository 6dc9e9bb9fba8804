"""`pinav live`: a session at a rig, or a recording told as a rig would."""

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np

from pinav.commands.command import CommandResult
from pinav.commands.data_file import read_data
from pinav.commands.live import LiveOptions, LiveSettings
from pinav.errors import InputError
from pinav.identification.tracks import tracks
from pinav.live.checkpoint import read_session, with_drive_of
from pinav.live.estimators import DriveEstimator
from pinav.live.loop import Loop, lines_in, lines_of, replay
from pinav.live.messages import Command, Event, FromPinav, Limits, State
from pinav.live.page import EventPrinter, Page, Places
from pinav.live.roller_pilot import RollerPilot
from pinav.live.session import Session
from pinav.live.sources import sink_of, source_of

CHECKPOINT = "session.npz"
"""Name of the checkpoint in --out."""


class LiveMetrics(msgspec.Struct):
    """What a session came to.

    Attributes:
        frames: that were learned from.
        commands: that were given.
        refused: lines that were no message.
        mode: at the end.
        latency_p50_ms: from a line to the state that answers it, median.
        latency_p99_ms: of 99 % of the frames.
    """

    frames: int = 0
    commands: int = 0
    refused: int = 0
    mode: str = "waiting"
    latency_p50_ms: float | None = None
    latency_p99_ms: float | None = None


class Tally:
    """Counts what is said, and passes it on to a printer and a page."""

    def __init__(self, printer: EventPrinter, page: Page | None) -> None:
        self.printer, self.page = printer, page
        self.counted = LiveMetrics()
        self.latencies: list[float] = []

    def show(self, answer: FromPinav) -> None:
        """Print an answer, and show it on the page."""
        counted = self.counted
        if isinstance(answer, State):
            counted.frames, counted.mode = counted.frames + 1, str(answer.mode)
            if answer.latency_ms is not None:
                self.add_latency(answer.latency_ms)
        counted.commands += isinstance(answer, Command)
        counted.refused += isinstance(answer, Event) and answer.kind == "refused"
        self.printer.show(answer)
        if self.page is not None:
            self.page.show(answer)

    def add_latency(self, milliseconds: float) -> None:
        """Count a latency; the last ones stand for a session that is long."""
        if len(self.latencies) >= MOST_LATENCIES:
            del self.latencies[: MOST_LATENCIES // 2]
        self.latencies.append(milliseconds)

    def metrics(self) -> LiveMetrics:
        """The numbers of the session."""
        if self.latencies:
            half, most = map(float, np.quantile(self.latencies, [0.5, 0.99]))
            self.counted.latency_p50_ms, self.counted.latency_p99_ms = half, most
        return self.counted


MOST_LATENCIES = 100_000
"""Latencies that are kept."""


def new_session(
    settings: LiveSettings, token: str = "", prior: Path | None = None
) -> Session:
    """The session that settings ask for, with nothing learned but an earlier drive.

    Args:
        prior: folder of an earlier session.

    Raises:
        InputError: `prior` holds no session that has seen the robot driven.
    """
    goal = settings.goal()
    pilot = None
    if goal is not None:
        discs = np.array(settings.discs(), float).reshape(-1, 3)
        pilot = RollerPilot(np.array(goal), settings.tolerance, discs)
    session = Session(DriveEstimator(), pilot, token)
    return session if prior is None else with_drive_of(prior / CHECKPOINT, session)


def run(options: LiveOptions) -> CommandResult:
    """Run a session as the command line does.

    Raises:
        InputError: the source, the checkpoint or the recording cannot be used.
    """
    with contextlib.ExitStack() as stack:
        page = None
        if options.page is not None:
            places = Places(options.settings.goal(), tuple(options.settings.discs()))
            page = stack.enter_context(Page.serve(options.page, places))
            print(f"page: {page.address}", file=sys.stderr, flush=True)
        tally = Tally(EventPrinter(_print, people=options.status), page)
        if options.replay:
            _replay(options, tally)
        else:
            _live(options, tally)
    metrics = tally.metrics()
    print(_summary(metrics), file=sys.stderr)
    return CommandResult(metrics, "")


def _print(text: str) -> None:
    sys.stdout.write(text)
    sys.stdout.flush()


def _live(options: LiveOptions, tally: Tally) -> None:
    token = _secret(options.token)
    session = new_session(options.settings, token, options.prior)
    checkpoint = None
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        checkpoint = options.out / CHECKPOINT
        if options.resume and checkpoint.exists():
            session = read_session(checkpoint, session)
        elif checkpoint.exists():
            raise InputError(
                f"{checkpoint} holds a session; go on with --resume, or choose another "
                "folder with --out"
            )
    source = source_of(options.source, token)
    sink = sink_of(options.commands_to, source, token)
    limits = Limits(frequency=options.settings.frequency)
    loop = Loop(session, source, sink, tally.show, checkpoint, limits)
    most = options.frames
    loop.run(lambda s: most is not None and s.counts.frames >= most)
    source.close()


def _replay(options: LiveOptions, tally: Tally) -> None:
    for lines in _lines_of_tracks(Path(options.source), options):
        session = new_session(options.settings, prior=options.prior)
        for answer, took in replay(session, lines, options.rate()):
            tally.show(answer)
            if isinstance(answer, State):
                tally.add_latency(1e3 * took)
            if options.frames is not None and tally.counted.frames >= options.frames:
                break


def _lines_of_tracks(path: Path, options: LiveOptions) -> Iterator[Iterator[bytes]]:
    """The lines of each track of a recording; those of a file in the protocol."""
    if not path.exists():
        raise InputError(f"{path}: no such file")
    if path.suffix in (".jsonl", ".ndjson"):
        yield lines_in(path)
        return
    recording = read_data(path, options.reading)
    units = recording.units.get("x", "")
    for track in sorted(tracks(recording), key=lambda track: track.name):
        yield lines_of(track, units)


def _secret(path: Path | None) -> str:
    if path is None:
        return ""
    text = path.read_text(encoding="utf-8").strip()
    if not 8 <= len(text) <= 200:
        raise InputError(f"{path}: expected a secret of 8 to 200 characters")
    return text


def _summary(metrics: LiveMetrics) -> str:
    text = f"{metrics.frames} frames, {metrics.commands} commands, {metrics.mode}"
    if metrics.latency_p99_ms is None:
        return text
    return (
        f"{text}; a frame took {metrics.latency_p50_ms:.1f} ms, "
        f"99 % at most {metrics.latency_p99_ms:.1f} ms"
    )
