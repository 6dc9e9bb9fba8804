"""One particle of a recording: its rows in order of time, with its commands."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from pinav.errors import InputError
from pinav.recordings.rows import FRAMES, Reading, Tracks

Name = tuple[str, str, str]
"""Run, kind and particle."""


@final
@dataclasses.dataclass(frozen=True, eq=False)
class Particle:
    """Rows of one particle.

    Attributes:
        rows: their indices in the tracks, in order of time.
        times: increasing.
        positions: in the file's unit and orientation.
        seen: where there is a position.
        commands: as they act, offset and delay applied.
        repeats: rows that were left out, because their time was that of the one before.
        silent: rows for which the log has no command; the last one is held.
    """

    rows: Int64[np.ndarray, " row"]
    times: Float64[np.ndarray, " row"]
    positions: Float64[np.ndarray, "row 2"]
    seen: Bool[np.ndarray, " row"]
    commands: dict[str, Float64[np.ndarray, " row"]]
    repeats: int
    silent: int


def particles(tracks: Tracks, reading: Reading) -> dict[Name, Particle]:
    """The particles of a recording by name, in the order in which they appear.

    Raises:
        InputError: a frame stands twice, times do not increase, or times are wanted
            that the file does not have.
    """
    times = _times(tracks, reading)
    groups: dict[Name, list[int]] = {}
    for row, name in enumerate(_names(tracks)):
        groups.setdefault(name, []).append(row)
    return {
        name: _particle(tracks, reading, times, np.array(rows, np.int64))
        for name, rows in groups.items()
    }


def _names(tracks: Tracks) -> Iterator[Name]:
    blank = [""] * len(tracks.x)
    return zip(
        tracks.run or blank, tracks.kind or blank, tracks.particle or blank, strict=True
    )


def time_unit(tracks: Tracks, reading: Reading) -> str:
    """Unit of the times that `particles` gives."""
    if reading.fps is not None:
        return "s"
    return FRAMES if tracks.time is None else tracks.time_unit


def _times(tracks: Tracks, reading: Reading) -> Float64[np.ndarray, " row"]:
    if reading.fps is not None:
        if tracks.frame is None:
            raise InputError("fps: the file has times and no frames; leave it out")
        return tracks.frame / reading.fps
    if tracks.time is not None:
        return tracks.time
    if tracks.frame is None:
        raise InputError(
            "the file has neither times nor frames; name their column by a column map"
        )
    return tracks.frame.astype(np.float64)


def _particle(
    tracks: Tracks, reading: Reading, times: np.ndarray, rows: np.ndarray
) -> Particle:
    rows = _ordered(tracks, rows)
    kept = _advancing(tracks, times, rows)
    repeats = len(rows) - len(kept)
    rows = kept
    ordered = times[rows]
    positions = np.stack([tracks.x[rows], tracks.y[rows]], axis=1)
    commands = {n: c[rows] for n, c in tracks.commands.items()}
    unknown = [np.isnan(values) for values in commands.values()]
    return Particle(
        rows=rows,
        times=ordered,
        positions=positions,
        seen=np.asarray(np.isfinite(positions).all(axis=1)),
        commands=_acting(commands, ordered, reading),
        repeats=repeats,
        silent=int(np.any(unknown, axis=0).sum()),
    )


def _ordered(tracks: Tracks, rows: np.ndarray) -> np.ndarray:
    """Rows in order of frames, where there are any."""
    if tracks.frame is None:
        return rows
    rows = rows[np.argsort(tracks.frame[rows], kind="stable")]
    twice = np.flatnonzero(np.diff(tracks.frame[rows]) == 0)
    if twice.size:
        first, second = rows[[twice[0], twice[0] + 1]].tolist()
        whose = "" if tracks.particle is None else f" of {tracks.particle[second]!r}"
        raise InputError(
            f"{tracks.where(second, 'frame')}: frame {tracks.frame[second]}{whose} "
            f"stands in {tracks.place(first)} already; delete one of the two"
        )
    return rows


def _advancing(tracks: Tracks, times: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Rows whose time is after that of the row before.

    Clocks with coarse ticks may give two frames one time; the second is left out.
    """
    ordered = times[rows]
    late = np.flatnonzero(
        np.diff(ordered) < (0 if tracks.frame is not None else 1e-300)
    )
    if late.size:
        before, row = rows[[late[0], late[0] + 1]].tolist()
        fault = "repeats" if times[row] == times[before] else "is before"
        raise InputError(
            f"{tracks.where(row, 'time')}: time {times[row]:g} {fault} the time "
            f"{times[before]:g} of {tracks.place(before)}; sort the rows by time and "
            "delete repeats"
        )
    return rows[np.concatenate([[True], np.diff(ordered) > 0])]


def _acting(
    logged: Mapping[str, np.ndarray], times: np.ndarray, reading: Reading
) -> dict[str, np.ndarray]:
    """Commands as they act: gaps held, offset added, shifted by the delay."""
    commands = {name: _held(values) for name, values in logged.items()}
    if "heading" in commands:
        commands["heading"] = commands["heading"] + reading.heading_offset
    if reading.delay > 0:
        # Round-off must not hold a command for a sample too long.
        instants = times - reading.delay + 1e-9
        index = np.maximum(np.searchsorted(times, instants, "right") - 1, 0)
        commands = {name: values[index] for name, values in commands.items()}
    return commands


def _held(values: np.ndarray) -> np.ndarray:
    """The last known value where there is none, and at the start the first one."""
    known = np.flatnonzero(~np.isnan(values))
    if not known.size:
        return np.zeros_like(values)
    index = np.searchsorted(known, np.arange(len(values)), "right") - 1
    return values[known[np.maximum(index, 0)]]
