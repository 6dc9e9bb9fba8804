r"""Hidden faults of a recording, and remarks on its reading.

A doubt is a sentence with the option that settles it. A fit refuses a recording with
doubts; `pinav inspect` lists them. The velocity over half a second is regressed on the
drive $c = f (\cos\alpha, \sin\alpha)$: a gain matrix that mirrors says that y or the
heading points the other way, and one that turns by a right angle that the log holds the
azimuth of an axis.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from pinav.recordings.drive import window_ends
from pinav.trajectories import Trajectories, Trajectory

CLEAR = 0.3
"""Share of the velocity's variance that a gain must explain to say anything."""

BETTER = 0.1
"""By how much more of it a mirrored gain must explain to be believed."""

RIGHT_ANGLE = math.radians(25.0)
"""Offsets this close to a right angle are spoken of."""

TURNS = 2 * math.pi + 0.2
"""Headings beyond this are degrees, or turns that were counted on [rad]."""


def doubts(recording: Trajectories) -> list[str]:
    """Doubts for which a fit refuses the recording, each with its option."""
    return [
        *recording.provenance.get("doubts", {}).values(),
        *_of_times(recording),
        *_of_mirror(recording),
        *_of_reversal(recording),
        *_of_degrees(recording),
    ]


def _of_times(recording: Trajectories) -> list[str]:
    if recording.units["t"] != "frame":
        return []
    return [
        "times are numbers of frames: give --fps, the frames per second of the film "
        "(1 where one frame was taken in a second)"
    ]


def _of_mirror(recording: Trajectories) -> list[str]:
    said = recording.provenance.get("positions", {})
    if "y stated" not in said or said["y stated"]:
        return []
    proper, mirrored = rotations(recording)
    if mirrored < CLEAR or mirrored < proper + BETTER:
        return []
    other = "up" if said["y flipped"] else "down"
    return [
        f"motion mirrors the commands: with y as it was read they explain "
        f"{100 * max(proper, 0.0):.0f} % of the velocity, with y the other way round "
        f"{100 * mirrored:.0f} %; give --y {other}, or --y "
        f"{'down' if other == 'up' else 'up'} where y is right and the log of headings "
        "is mirrored"
    ]


def _of_reversal(recording: Trajectories) -> list[str]:
    count = int((recording.commands.get("frequency", np.zeros(1)) < 0).sum())
    if not count or "positions" not in recording.provenance:
        return []
    return [
        f"{count} rows have a negative frequency: write its size, and add pi to the "
        "heading of a robot that rolls backwards"
    ]


def _of_degrees(recording: Trajectories) -> list[str]:
    said = recording.provenance
    stated = "heading" in said.get("units of columns", {})
    if stated or said.get("format") != "table":
        return []
    text = _degrees_in_words(recording)
    return [text] if text else []


def _degrees_in_words(recording: Trajectories) -> str:
    """Sentence for motion that follows the headings as if they were degrees."""
    best = max(rotations(recording, math.radians(1.0)))
    read = max(rotations(recording))
    if best < CLEAR or best < read + BETTER:
        return ""
    return (
        f"headings in radians explain {100 * max(read, 0.0):.0f} % of the velocity, in "
        f"degrees {100 * best:.0f} %: --units heading=deg or heading=rad settles it"
    )


def remarks_on_headings(recording: Trajectories) -> list[str]:
    """Remarks on odd headings although their convention is stated."""
    said = [heading_remark(recording)]
    if not _of_degrees(recording):
        said.append(_degrees_in_words(recording))
    proper, mirrored = rotations(recording)
    stated = recording.provenance.get("positions", {}).get("y stated", False)
    if stated and mirrored >= CLEAR and mirrored >= proper + BETTER:
        said.append(
            f"motion mirrors the commands: they explain {100 * max(proper, 0.0):.0f} % "
            "of the velocity, with headings counted the other way "
            f"{100 * mirrored:.0f} %; check --y, the sense of the headings, and that x "
            "and y are not exchanged"
        )
    return [text for text in said if text]


def heading_remark(recording: Trajectories) -> str:
    """Remark on a heading that is off by about a right angle; mostly empty."""
    samples = _samples(recording)
    if samples is None:
        return ""
    velocity, drive = samples
    gain = _complex_gain(velocity, drive)[0]
    offset = math.atan2(gain.imag, gain.real)
    if abs(abs(offset) - math.pi / 2) > RIGHT_ANGLE or rotations(recording)[0] < CLEAR:
        return ""
    given = recording.provenance.get("commands", {}).get("heading_offset", 0.0)
    return (
        f"the motion is {math.degrees(offset):.0f} degrees off the logged heading, "
        "which may be the azimuth of the rotation axis: --heading-offset "
        f"{given + math.copysign(math.pi / 2, offset):.4f} makes it that of the motion"
    )


def rotations(recording: Trajectories, scale: float = 1.0) -> tuple[float, float]:
    """Shares of the velocity's variance that a turned and a mirrored gain explain.

    Args:
        scale: factor on the logged headings.
    """
    samples = _samples(recording, scale)
    if samples is None:
        return 0.0, 0.0
    velocity, drive = samples
    return _complex_gain(velocity, drive)[1], _complex_gain(velocity, drive.conj())[1]


def _complex_gain(velocity: np.ndarray, drive: np.ndarray) -> tuple[complex, float]:
    """Complex gain of a drive with a drift, and the share that it explains."""
    columns = np.stack([drive, np.ones_like(drive)], axis=1)
    gain, _, _, _ = np.linalg.lstsq(columns, velocity)
    left = velocity - columns @ gain
    spread = np.abs(velocity - velocity.mean()) ** 2
    return complex(gain[0]), 1.0 - float(
        (np.abs(left) ** 2).sum() / max(spread.sum(), 1e-30)
    )


def _samples(
    recording: Trajectories, scale: float = 1.0
) -> tuple[np.ndarray, np.ndarray] | None:
    """Velocities and drives of all trajectories as complex numbers; None where idle."""
    if not {"frequency", "heading"} <= set(recording.commands):
        return None
    offset = recording.provenance.get("commands", {}).get("heading_offset", 0.0)
    parts = [
        _velocities(piece, offset + scale * (piece.commands["heading"] - offset))
        for piece in recording
    ]
    velocity = np.concatenate([v for v, _ in parts])
    drive = np.concatenate([c for _, c in parts])
    if len(velocity) < 20 or not (np.abs(drive) > 0).any():
        return None
    return velocity, drive


def _velocities(
    piece: Trajectory, heading: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    first, last = window_ends(piece)
    seen = np.flatnonzero(piece.observed[:, :2].all(axis=1))
    drive = (piece.commands["frequency"] * np.exp(1j * heading))[seen]
    along = np.zeros(len(piece.times), complex)
    along[seen[1:]] = np.cumsum(drive[:-1] * np.diff(piece.times[seen]))
    path = piece.states[:, 0] + 1j * piece.states[:, 1]
    interval = piece.times[last] - piece.times[first]
    return (path[last] - path[first]) / interval, (
        along[last] - along[first]
    ) / interval


def remarks(recording: Trajectories) -> tuple[str, ...]:
    """Remarks on the reading of a recording, its omissions and oddities."""
    said = in_words(recording.provenance)
    if not said:
        return ()
    bad = recording.provenance.get("bad rows left out", [])
    return (
        f"read as: {'; '.join(said)}",
        *((f"{len(bad)} bad rows left out, the first: {bad[0]}",) if bad else ()),
        *remarks_on_headings(recording),
        *recording.provenance.get("notes", []),
    )


def in_words(provenance: Mapping[str, Any]) -> list[str]:
    """Flips, scales, shifts and omissions of the reading, in words."""
    if "positions" not in provenance:
        return []
    positions, times = provenance["positions"], provenance["times"]
    commands = provenance["commands"]
    said = [
        f"positions in {positions['unit in the file']}"
        + (f", multiplied by {positions['scale']:g}" if positions["scale"] != 1 else "")
        + (", y flipped to point up" if positions["y flipped"] else ", y as it is"),
        f"times from frames at {times['fps']:g} per second"
        if times["fps"]
        else f"times in {times['unit in the file']}",
    ]
    if commands["heading_offset"]:
        said.append(f"heading + {math.degrees(commands['heading_offset']):.1f} degrees")
    if commands["delay"]:
        said.append(f"commands {commands['delay']:g} s late")
    return said
