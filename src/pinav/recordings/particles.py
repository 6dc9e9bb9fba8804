"""One particle of a recording: its rows by time, its commands and segments."""

import dataclasses
from collections.abc import Mapping
from typing import final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from pinav.errors import InputError
from pinav.recordings.rows import FRAMES, Reading, Tracks


@final
@dataclasses.dataclass(frozen=True, eq=False)
class Particle:
    """Rows of one particle.

    Attributes:
        rows: indices in the tracks, in order of time.
        positions: in the file's unit and orientation.
        commands: commands in action, with offset and delay applied.
        repeats: rows left out because they repeat the time of the row before.
        silent: rows without a command in the log; the last one is held.
        faults: sentences on rows left out because they contradict others.
    """

    rows: Int64[np.ndarray, " row"]
    times: Float64[np.ndarray, " row"]
    positions: Float64[np.ndarray, "row dim"]
    observed: Bool[np.ndarray, " row"]
    commands: dict[str, Float64[np.ndarray, " row"]]
    repeats: int
    silent: int
    faults: tuple[str, ...] = ()


def particles(tracks: Tracks, reading: Reading) -> dict[tuple[str, str, str], Particle]:
    """The particles of a recording by `Tracks.names`, in the order of appearance."""
    times = _times(tracks, reading)
    groups: dict[tuple[str, str, str], list[int]] = {}
    for row, name in enumerate(tracks.names):
        groups.setdefault(name, []).append(row)
    return {
        name: _particle(tracks, reading, times, np.array(rows, np.int64))
        for name, rows in groups.items()
    }


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
    rows, twice = _order_by_frame(tracks, rows)
    rows, late = _not_before(tracks, times, rows)
    faults = (*twice, *late)
    if faults and (reading.strict or len(faults) > WORST * len(rows)):
        raise InputError(faults[0])
    kept = rows[np.concatenate([[True], np.diff(times[rows]) > 0])]
    repeats = len(rows) - len(kept)
    rows = kept
    ordered = times[rows]
    positions = tracks.positions()[rows]
    commands = {n: c[rows] for n, c in tracks.commands.items()}
    unknown = [np.isnan(values) for values in commands.values()]
    known = {name: _hold_last(values) for name, values in commands.items()}
    return Particle(
        rows=rows,
        times=ordered,
        positions=positions,
        observed=np.asarray(np.isfinite(positions).all(axis=1)),
        commands=acting(ordered, ordered, known, reading),
        repeats=repeats,
        silent=int(np.any(unknown, axis=0).sum()),
        faults=faults,
    )


WORST = 0.1
"""Share of bad rows beyond which a file is refused, although bad rows are left out."""


def _order_by_frame(tracks: Tracks, rows: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Rows in order of frames, where there are any, the first of each; and faults."""
    if tracks.frame is None:
        return rows, []
    rows = rows[np.argsort(tracks.frame[rows], kind="stable")]
    new = np.concatenate([[True], np.diff(tracks.frame[rows]) > 0])
    faults = []
    for place in np.flatnonzero(~new).tolist():
        first, second = rows[[place - 1, place]].tolist()
        whose = "" if tracks.particle is None else f" of {tracks.particle[second]!r}"
        faults.append(
            f"{tracks.where(second, 'frame')}: frame {tracks.frame[second]}{whose} "
            f"stands in {tracks.place(first)} already; delete one of the two"
        )
    return rows[new], faults


def _not_before(
    tracks: Tracks, times: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, list[str]]:
    """Rows whose time is not before an earlier one (ties pass), and faults."""
    latest, before, kept, faults = -np.inf, -1, [], []
    for row in rows.tolist():
        time = times[row]
        if time > latest or (time == latest and tracks.frame is not None):
            latest, before = time, row
            kept.append(row)
            continue
        fault = "repeats" if time == latest else "is before"
        faults.append(
            f"{tracks.where(row, 'time')}: time {time:g} {fault} the time "
            f"{latest:g} of {tracks.place(before)}; sort the rows by time and "
            "delete repeats, or name the column of runs or particles"
        )
    return np.array(kept, np.int64), faults


def acting(
    times: np.ndarray,
    logged: np.ndarray,
    commands: Mapping[str, np.ndarray],
    reading: Reading,
) -> dict[str, np.ndarray]:
    """Commands in action at some times: the last one logged, offset and delayed.

    Args:
        times: times at which they act.
        logged: increasing times of the commands; the first acts before it, too.
    """
    # Round-off must not hold a command for a sample too long.
    instants = times - reading.delay + 1e-9
    index = np.maximum(np.searchsorted(logged, instants, "right") - 1, 0)
    acting = {name: values[index] for name, values in commands.items()}
    if "heading" in acting:
        acting["heading"] = acting["heading"] + reading.heading_offset
    return acting


def _hold_last(values: np.ndarray) -> np.ndarray:
    """The last known value where there is none; at the start the first known one."""
    known = np.flatnonzero(~np.isnan(values))
    index = np.searchsorted(known, np.arange(len(values)), "right") - 1
    return values[known[np.maximum(index, 0)]]


JUMPS: Mapping[str, float] = {"px": 40.0, "um": 15.0}
"""Displacement from one row to the next that no swimmer makes, by unit of length.

Where the unit is unknown, a track is split at steps far beyond its own.
"""

BEYOND, ORDINARY, LEAST_STEPS = 20.0, 0.95, 20
"""Without a unit, a jump is so many times the quantile `ORDINARY` of the steps, if
there are that many of them."""


def _jump_limit(
    unit: str, jump: float | None, steps: Float64[np.ndarray, " step"]
) -> float:
    """Displacement beyond which a track is split [unit of length]."""
    if jump is not None:
        return jump
    if unit in JUMPS:
        return JUMPS[unit]
    if len(steps) < LEAST_STEPS:
        return np.inf
    ordinary = float(np.quantile(steps, ORDINARY))
    return BEYOND * ordinary if ordinary > 0 else np.inf


def segments(
    tracks: Tracks, particle: Particle, reading: Reading
) -> Int64[np.ndarray, " row"]:
    """Number of the segment of each row of a particle, 0 first.

    Those of the file are kept where it has them. What lies on either side of a cut may
    be two particles, and is never bridged. A gap is counted in frames; without frames,
    in median steps of time.
    """
    if tracks.segment is not None:
        return tracks.segment[particle.rows]
    observed = np.flatnonzero(particle.observed)
    steps = np.linalg.norm(np.diff(particle.positions[observed], axis=0), axis=1)
    limit = _jump_limit(tracks.length_unit, reading.jump, steps)
    cuts = (steps > limit) | (_frames_between(tracks, particle, observed) > reading.gap)
    numbers = np.zeros(len(particle.rows), np.int64)
    numbers[observed[1:][cuts]] = 1
    return np.cumsum(numbers)


def _frames_between(
    tracks: Tracks, particle: Particle, observed: np.ndarray
) -> Float64[np.ndarray, " step"]:
    if tracks.frame is not None:
        return np.diff(tracks.frame[particle.rows[observed]]).astype(np.float64)
    steps = np.diff(particle.times[observed])
    return np.round(steps / np.median(steps)) if len(steps) else steps
