"""From a file's rows to `Trajectories`: one for each run, particle and segment."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from pinav import __version__
from pinav.errors import InputError
from pinav.recordings.particles import Particle, particles, time_unit
from pinav.recordings.rows import COMMAND_UNITS, FRAMES, Reading, Tracks, in_known_units
from pinav.recordings.segments import JUMPS, segments
from pinav.recordings.source import Source
from pinav.trajectories import Trajectories


class _Piece(NamedTuple):
    """One trajectory, and what it is called."""

    label: dict[str, str | int]
    times: Float64[np.ndarray, " time"]
    positions: Float64[np.ndarray, "time 2"]
    seen: Bool[np.ndarray, " time"]
    commands: dict[str, Float64[np.ndarray, " time"]]


def assembled(
    tracks: Tracks, reading: Reading, source: Source, format: str
) -> Trajectories:
    """The trajectories of a recording, in um and s with y up where scales are known.

    Args:
        tracks: rows of the file.
        reading: how they are to be read.
        source: the file.
        format: name of its format.

    Raises:
        InputError: rows contradict each other, or nothing is long enough to be a
            trajectory.
    """
    tracks = in_known_units(tracks, reading)
    _check_commands(tracks, reading)
    by_name = particles(tracks, reading)
    pieces = [
        piece
        for (run, kind, particle), particle_rows in by_name.items()
        for piece in _pieces(
            tracks, particle_rows, reading, (run or source.stem, kind, particle or "1")
        )
    ]
    whole = [piece for piece in pieces if len(piece.times) > 1]
    if not whole:
        raise InputError(
            f"the longest of {len(pieces)} segments has a single position; "
            "expected two or more rows of a particle within a gap and a jump"
        )
    scale, unit = _scale(tracks, reading)
    flip = -1.0 if _y_down(tracks, reading) else 1.0
    return Trajectories.from_arrays(
        [piece.times for piece in whole],
        [scale * np.array([1.0, flip]) * piece.positions for piece in whole],
        observed=[np.stack([piece.seen] * 2, axis=1) for piece in whole],
        commands={
            name: [piece.commands[name] for piece in whole] for name in tracks.commands
        },
        channels=("x", "y"),
        units={
            "x": unit,
            "y": unit,
            "t": time_unit(tracks, reading),
            **{name: COMMAND_UNITS[name] for name in tracks.commands},
        },
        provenance={
            "source": source.path.name,
            "format": format,
            "pinav": __version__,
            **_conventions(tracks, reading),
            **tracks.facts,
            "repeated times left out": sum(p.repeats for p in by_name.values()),
            "rows without a command": sum(p.silent for p in by_name.values()),
            "segments left out": [p.label for p in pieces if len(p.times) < 2],
            "notes": [*tracks.notes, *_rate_notes(tracks, reading)],
            "trajectories": [piece.label for piece in whole],
        },
    )


def _rate_notes(tracks: Tracks, reading: Reading) -> list[str]:
    """A rate that the file contradicts, in words."""
    if reading.fps is None or tracks.time is None or tracks.frame is None:
        return []
    span = np.ptp(tracks.time), np.ptp(tracks.frame)
    rate = span[1] / span[0] if span[0] > 0 else np.inf
    if abs(rate / reading.fps - 1) < 0.01:
        return []
    return [f"fps {reading.fps:g} was given, the times of the file say {rate:.4g}"]


def _check_commands(tracks: Tracks, reading: Reading) -> None:
    if reading.delay > 0 and time_unit(tracks, reading) == FRAMES:
        raise InputError("delay: times are in frames; give fps too")
    if tracks.commands:
        return
    for name in ("delay", "heading_offset"):
        if getattr(reading, name) != 0:
            raise InputError(f"{name}: the file has no commands; leave it out")


def _y_down(tracks: Tracks, reading: Reading) -> bool:
    return tracks.y_down if reading.y_down is None else reading.y_down


def _scale(tracks: Tracks, reading: Reading) -> tuple[float, str]:
    """Factor on the file's positions, and the unit that they have then."""
    if reading.mpp is None:
        return 1.0, tracks.length_unit
    if tracks.length_unit == "um":
        raise InputError("mpp: positions are in um already; leave it out")
    return reading.mpp, "um"


def _conventions(tracks: Tracks, reading: Reading) -> dict[str, Any]:
    """What was done to positions, times and commands."""
    scale, _unit = _scale(tracks, reading)
    jump = reading.jump or JUMPS.get(tracks.length_unit)
    return {
        "positions": {
            "unit in the file": tracks.length_unit,
            "scale": scale,
            "y flipped": _y_down(tracks, reading),
        },
        "times": {
            "unit in the file": FRAMES if tracks.time is None else tracks.time_unit,
            "fps": reading.fps,
        },
        "commands": {
            "heading_offset": reading.heading_offset,
            "delay": reading.delay,
            "delayed by": "shifting the commands, zero-order hold",
        },
        "segments": {"from": "the file"}
        if tracks.segment is not None
        else {"from": "jumps and gaps", "jump": jump, "gap": reading.gap},
    }


def _pieces(
    tracks: Tracks, particle: Particle, reading: Reading, name: tuple[str, str, str]
) -> Iterator[_Piece]:
    """The segments of a particle, from their first to their last position."""
    run, kind, particle_name = name
    label: dict[str, str | int] = {"run": run, "particle": particle_name}
    if kind:
        label |= {"particle": f"{kind} {particle_name}", "kind": kind}
    numbers = segments(tracks, particle, jump=reading.jump, gap=reading.gap)
    for number in dict.fromkeys(numbers.tolist()):
        rows = np.flatnonzero((numbers == number) & particle.seen)
        if not rows.size:
            continue
        extent = slice(rows[0], rows[-1] + 1)
        yield _Piece(
            {**label, "segment": number},
            particle.times[extent],
            particle.positions[extent],
            particle.seen[extent],
            {name: values[extent] for name, values in particle.commands.items()},
        )
