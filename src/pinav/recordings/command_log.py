"""A log of commands beside a tracker's file: two clocks, brought together.

The log's command holds until the next one. Where both files count time, the offset of
the clocks is the shift at which the commands explain most of the velocity, with an
interval from the fall of the likelihood about it; where both count frames, the frames
are the same.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from pinav.errors import InputError
from pinav.reading import PLAIN, Reading
from pinav.recordings import units
from pinav.recordings.conventions import rotations
from pinav.recordings.particles import acting
from pinav.recordings.rows import COMMAND_UNITS, FRAMES, read_commands
from pinav.recordings.source import Source
from pinav.recordings.table import example_of_columns, likely_columns
from pinav.trajectories import Trajectories, Trajectory

FIRM = 0.1
"""Share of the velocity that the commands must explain before an offset is believed."""

INDEPENDENT = 1.0
"""Time after which velocities count as independent of each other [s]."""


class CommandLog(NamedTuple):
    """Commands in the log's own time."""

    times: Float64[np.ndarray, " entry"]
    commands: dict[str, Float64[np.ndarray, " entry"]]
    counts_frames: bool


class Offset(NamedTuple):
    """Shift from the log's times to those of the tracker [s]."""

    value: float
    low: float
    high: float
    explained: float


def read_log(source: Source, reading: Reading) -> CommandLog:
    """The commands of a log, in Hz and rad, by time or frame."""
    table = source.table()
    names = list(table.columns)
    given = reading.columns or {}
    here = {q: c for q, c in given.items() if table.resolve(c) in table.columns}
    columns = {**likely_columns(names), **here}
    known = [name for name in COMMAND_UNITS if name in columns]
    clock = next((name for name in ("t", "frame") if name in columns), None)
    if clock is None or not known:
        raise InputError(
            f"{source.path.name}: expected a column of time or frame and some of "
            f"{', '.join(COMMAND_UNITS)}; got {', '.join(names)}; name them, such as "
            f"{example_of_columns(names).replace('x=', 'heading=').partition(' y=')[0]}"
        )
    named = {name: columns[name] for name in known}
    commands = read_commands(table, named, reading.units or {}, lost=False)
    if clock == "frame":
        times = table.whole_numbers(columns["frame"], least=0).astype(np.float64)
    else:
        times = table.times(columns["t"])[0]
        times = times * (units.duration(table.unit(columns["t"]))[0])
    order = np.argsort(times, kind="stable")
    return CommandLog(
        times[order], {n: c[order] for n, c in commands.items()}, clock == "frame"
    )


def with_commands(
    recording: Trajectories, log: CommandLog, reading: Reading
) -> Trajectories:
    """The recording with the commands of a log, as a reading states."""
    if recording.commands:
        raise InputError("commands: the file has commands itself; leave the log out")
    times = log.times
    if log.counts_frames and recording.units["t"] != FRAMES:
        if reading.fps is None:
            raise InputError("commands: the log counts frames; give fps too")
        times = times / reading.fps
    elif not log.counts_frames and recording.units["t"] == FRAMES:
        raise InputError("commands: the log counts time; give fps for the tracker")
    offset = None
    if not log.counts_frames:
        offset = find_offset(recording, log._replace(times=times))
        times = times + offset.value
    last = max(float(p.times[-1]) for p in recording)
    first = min(float(p.times[0]) for p in recording)
    if times[0] > last or times[-1] < first:
        raise InputError(
            f"commands: the log, {times[0]:g} to {times[-1]:g}, and the recording, "
            f"{first:g} to {last:g}, never meet; check frames, fps and clocks"
        )
    said: dict[str, Any] = {"from": "a log", "rows": len(times)}
    if offset is not None:
        said["offset of its clock"] = offset._asdict()
    provenance: Mapping[str, Any] = {
        **recording.provenance,
        "commands": {**recording.provenance["commands"], **said},
        "notes": [*recording.provenance["notes"], *_note(offset)],
    }
    units = {**recording.units, **{n: COMMAND_UNITS[n] for n in log.commands}}
    pieces = _hold_commands(recording, log._replace(times=times), reading)
    return Trajectories.from_pieces(pieces, recording.channels, units, provenance)


def _note(offset: Offset | None) -> list[str]:
    if offset is None:
        return []
    if offset.explained < FIRM:
        return [
            "the commands of the log explain none of the motion at any shift of its "
            "clock: the clocks are taken to be the same"
        ]
    return [
        f"the clock of the log is {offset.value:+.2f} s off the tracker's "
        f"({offset.low:.2f} to {offset.high:.2f} s); commands were shifted, so that "
        "the delay of the drive is part of it"
    ]


def _hold_commands(
    recording: Trajectories, log: CommandLog, reading: Reading
) -> list[Trajectory]:
    """The pieces with the last command at each time; the first one before it."""
    return [
        dataclasses.replace(
            piece, commands=acting(piece.times, log.times, log.commands, reading)
        )
        for piece in recording
    ]


def find_offset(recording: Trajectories, log: CommandLog) -> Offset:
    """Shift of the log's clock at which its commands explain most of the velocity.

    The search covers the duration of both files, in steps that are refined three times.
    """
    if not {"frequency", "heading"} <= set(log.commands):
        return Offset(0.0, 0.0, 0.0, 0.0)
    first = min(float(piece.times[0]) for piece in recording)
    last = max(float(piece.times[-1]) for piece in recording)
    middle = first - log.times[0]
    reach = max(last - first, log.times[-1] - log.times[0])
    centres = np.unique([0.0, middle])
    places = np.concatenate([c + np.linspace(-reach, reach, 161) for c in centres])
    table: dict[float, float] = {}

    def fraction_at(shift: float) -> float:
        if shift not in table:
            table[shift] = _explained_fraction(recording, log, shift)
        return table[shift]

    best, step = max(places.tolist(), key=fraction_at), reach / 80
    for _ in range(3):
        best = max((best + step * np.linspace(-1, 1, 21)).tolist(), key=fraction_at)
        step /= 10
    top = fraction_at(best)
    if top < FIRM:
        return Offset(0.0, 0.0, 0.0, top)
    return Offset(best, *_interval(fraction_at, best, top, last - first), top)


def _interval(
    explained: Any, best: float, top: float, duration: float
) -> tuple[float, float]:
    """Limits at which twice the log likelihood has fallen by 3.84."""
    count = 2 * max(duration / INDEPENDENT, 2.0)
    ends = []
    for side in (-1.0, 1.0):
        shift = 1e-3
        while shift < duration:
            left = 1.0 - explained(best + side * shift)
            if count * math.log(max(left, 1e-12) / max(1.0 - top, 1e-12)) > 3.84:
                break
            shift *= 1.3
        ends.append(best + side * shift)
    return ends[0], ends[1]


def _explained_fraction(
    recording: Trajectories, log: CommandLog, shift: float
) -> float:
    """Share of the velocity's variance that a turned or a mirrored gain explains."""
    inside = any(
        piece.times[-1] > log.times[0] + shift
        and piece.times[0] < log.times[-1] + shift
        for piece in recording
    )
    if not inside:
        return 0.0
    moved = log._replace(times=log.times + shift)
    pieces = _hold_commands(recording, moved, PLAIN)
    channels, units = recording.channels, recording.units
    return max(rotations(Trajectories.from_pieces(pieces, channels, units, {})))
