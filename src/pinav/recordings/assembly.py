"""From a file's rows to `Trajectories`: one for each run, particle and segment."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from pinav import __version__
from pinav.errors import InputError
from pinav.recordings.particles import (
    BEYOND,
    JUMPS,
    ORDINARY,
    WORST,
    Particle,
    particles,
    segments,
    time_unit,
)
from pinav.recordings.rows import COMMAND_UNITS, FRAMES, Reading, Tracks, in_known_units
from pinav.recordings.source import Source
from pinav.trajectories import Trajectories, Trajectory


def assemble(tracks: Tracks, source: Source, format: str) -> Trajectories:
    """The trajectories of a recording, in um and s with y up where scales are known."""
    reading = source.reading
    tracks, faults = _sound(in_known_units(tracks, reading), source)
    tracks = _select(tracks, reading, source.stem)
    tracks = _drop_empty_commands(tracks)
    _check_commands(tracks, reading)
    by_name = particles(tracks, reading)
    pieces = [
        piece
        for (run, kind, name), particle in by_name.items()
        for piece in _pieces(
            tracks, particle, reading, (run or source.stem, kind, name or "1")
        )
    ]
    whole = [(label, piece) for label, piece in pieces if len(piece.times) > 1]
    if not whole:
        raise InputError(
            f"the longest of {len(pieces)} segments has a single position; "
            "expected two or more rows of a particle within a gap and a jump; check "
            "the unit of positions, or set --jump and --gap"
        )
    faults += [fault for particle in by_name.values() for fault in particle.faults]
    scale, unit = _scale(tracks, reading)
    flip = -1.0 if _y_down(tracks, reading) else 1.0
    channels = ("x", "y") if tracks.z is None else ("x", "y", "z")
    axes = scale * np.array([1.0, flip, 1.0][: len(channels)])
    return Trajectories.from_arrays(
        [piece.times for _, piece in whole],
        [axes * piece.states for _, piece in whole],
        observed=[piece.observed for _, piece in whole],
        commands={
            name: [piece.commands[name] for _, piece in whole]
            for name in tracks.commands
        },
        channels=channels,
        units={
            **dict.fromkeys(channels, unit),
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
            "bad rows left out": faults,
            "segments left out": [one for one, piece in pieces if len(piece.times) < 2],
            "doubts": dict(tracks.doubts),
            "notes": [
                *tracks.notes,
                *_rate_notes(tracks, reading),
                *_lost_notes(tracks, len(by_name)),
            ],
            "trajectories": [label for label, _ in whole],
        },
    )


def _sound(tracks: Tracks, source: Source) -> tuple[Tracks, list[str]]:
    """The rows without the bad ones, and what was wrong with those."""
    faults = source.faults or {}
    if not faults:
        return tracks, []
    kept = np.array([tracks.place(row) not in faults for row in range(len(tracks.x))])
    several = list(faults.values())
    if len(faults) > WORST * (len(tracks.x) + len(faults)):
        raise InputError(several[0])
    unusable = np.isnan(tracks.time) if tracks.time is not None else np.zeros(len(kept))
    if tracks.frame is not None:
        unusable = unusable + (tracks.frame < 0)
    if (kept & (unusable > 0)).any():  # the fault names another place than the rows
        raise InputError(several[0])
    return tracks.select(kept), several


def _select(tracks: Tracks, reading: Reading, stem: str) -> Tracks:
    count = len(tracks.x)
    kept = np.ones(count, bool)
    for option, names, chosen in (
        ("runs", tracks.run or [stem] * count, reading.runs),
        ("particles", tracks.particle or ["1"] * count, reading.particles),
    ):
        for name in chosen:
            if name not in names:
                several = ", ".join(dict.fromkeys(names))
                raise InputError(f"{option}: expected some of {several}; got {name!r}")
        if chosen:
            kept &= np.isin(names, list(chosen))
    return tracks if kept.all() else tracks.select(kept)


def _drop_empty_commands(tracks: Tracks) -> Tracks:
    """The rows without those particles' commands that the log never gives."""
    empty = [n for n, values in tracks.commands.items() if np.isnan(values).all()]
    commands = {n: c for n, c in tracks.commands.items() if n not in empty}
    names = np.array([" ".join(words) for words in tracks.names])
    for name in dict.fromkeys(names.tolist()):
        rows = names == name
        for command, values in commands.items():
            if np.isnan(values[rows]).all():
                raise InputError(
                    f"particle {name.strip() or '1'}: no row has a {command}, which "
                    "does not mean that the drive was off; check that log and tracker "
                    "share their frames, or choose others by particles"
                )
    notes = tuple(f"the column of {name} is empty: no such command" for name in empty)
    return dataclasses.replace(tracks, commands=commands, notes=(*tracks.notes, *notes))


def _rate_notes(tracks: Tracks, reading: Reading) -> list[str]:
    """A rate that the file contradicts, in words."""
    if reading.fps is None or tracks.time is None or tracks.frame is None:
        return []
    span = np.ptp(tracks.time), np.ptp(tracks.frame)
    rate = span[1] / span[0] if span[0] > 0 else np.inf
    if abs(rate / reading.fps - 1) < 0.01:
        return []
    return [f"fps {reading.fps:g} was given, the times of the file say {rate:.4g}"]


def _lost_notes(tracks: Tracks, count: int) -> list[str]:
    """Remarks on rows at a place where trackers put lost particles."""
    notes = []
    for place in (0.0, -1.0):
        rows = int(((tracks.x == place) & (tracks.y == place)).sum())
        if count < rows < len(tracks.x):
            notes.append(
                f"{rows} rows stand at exactly ({place:g}, {place:g}), where some "
                "trackers put a particle that is lost: leave their cells empty if so"
            )
    return notes


def _check_commands(tracks: Tracks, reading: Reading) -> None:
    if reading.delay > 0 and time_unit(tracks, reading) == FRAMES:
        raise InputError("delay: times are in frames; give fps too")
    if tracks.commands:
        return
    for name in ("delay", "heading_offset"):
        if getattr(reading, name) != 0:
            raise InputError(f"{name}: the file has no commands; leave it out")


def _y_down(tracks: Tracks, reading: Reading) -> bool:
    return tracks.y_down if reading.y is None else reading.y == "down"


def _scale(tracks: Tracks, reading: Reading) -> tuple[float, str]:
    """Factor on the file's positions, and the unit that they have then."""
    if reading.mpp is None:
        return 1.0, tracks.length_unit
    if tracks.length_unit == "um":
        raise InputError("mpp: positions are in um already; leave it out")
    return reading.mpp, "um"


def _conventions(tracks: Tracks, reading: Reading) -> dict[str, Any]:
    scale, _unit = _scale(tracks, reading)
    default = f"{BEYOND:g} times the {100 * ORDINARY:g} % quantile of the steps"
    jump = reading.jump or JUMPS.get(tracks.length_unit, default)
    return {
        "positions": {
            "unit in the file": tracks.length_unit,
            "scale": scale,
            "y flipped": _y_down(tracks, reading),
            "y stated": reading.y is not None,
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
) -> Iterator[tuple[dict[str, str | int], Trajectory]]:
    """The segments of a particle, from their first to their last position."""
    run, kind, particle_name = name
    label: dict[str, str | int] = {"run": run, "particle": particle_name}
    if kind:
        label |= {"particle": f"{kind} {particle_name}", "kind": kind}
    numbers = segments(tracks, particle, reading)
    for number in dict.fromkeys(numbers.tolist()):
        rows = np.flatnonzero((numbers == number) & particle.observed)
        if not rows.size:
            continue
        extent = slice(rows[0], rows[-1] + 1)
        seen = particle.observed[extent, None]
        positions = particle.positions[extent]
        yield (
            {**label, "segment": number},
            Trajectory(
                times=particle.times[extent],
                states=positions,
                observed=np.broadcast_to(seen, positions.shape),
                commands={n: values[extent] for n, values in particle.commands.items()},
            ),
        )


def labels(trajectories: Trajectories) -> list[dict[str, str | int]]:
    """Run, particle and segment of each trajectory of a recording.

    Raises:
        InputError: they were not read from a recording.
    """
    several = _labels(trajectories.provenance)
    if several is None or len(several) != len(trajectories):
        raise InputError(
            "labels: these trajectories say nothing of runs and particles; expected "
            "those that read_recording gives"
        )
    return several


def _labels(provenance: Mapping[str, Any]) -> list[dict[str, str | int]] | None:
    if "concatenated" in provenance:
        parts = [_labels(part) for part in provenance["concatenated"]]
        known = [label for part in parts if part is not None for label in part]
        several = known if None not in parts else None
    else:
        several = provenance.get("trajectories")
    if several is None or "selection" not in provenance:
        return several
    return [several[index] for index in provenance["selection"]]


def groups(
    trajectories: Trajectories, *names: str
) -> dict[tuple[str | int, ...], list[int]]:
    """Indices of the trajectories with the same labels, in order of appearance.

    Args:
        names: labels that tell groups apart; run and particle by default.

    Raises:
        InputError: they were not read from a recording, or have no such label.
    """
    names = names or ("run", "particle")
    indices: dict[tuple[str | int, ...], list[int]] = {}
    for index, label in enumerate(labels(trajectories)):
        for name in names:
            if name not in label:
                raise InputError(
                    f"groups: no label {name!r}; expected some of {', '.join(label)}"
                )
        indices.setdefault(tuple(label[name] for name in names), []).append(index)
    return indices


def image_positions(
    recording: Trajectories, positions: Float[np.ndarray, "*batch 2"]
) -> Float[np.ndarray, "*batch 2"]:
    """Observed or predicted positions [L] in pixels of the images, y down.

    Raises:
        InputError: the recording was not read from pixels.
    """
    done = recording.provenance.get("positions", {})
    if done.get("unit in the file") != "px":
        raise InputError(
            "image: positions were not read from pixels; read the recording with mpp "
            "from a file that has them"
        )
    flip = -1.0 if done["y flipped"] else 1.0
    return np.asarray(positions) / done["scale"] * np.array([1.0, flip])
