"""Segments of a track: where it is cut, their labels, their place in the image.

What lies on either side of a cut may be two particles, and is never bridged.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Float64, Int64

from pinav.errors import InputError
from pinav.recordings.particles import Particle
from pinav.recordings.rows import Tracks
from pinav.trajectories import Trajectories


def labels(trajectories: Trajectories) -> list[dict[str, str | int]]:
    """Run, particle and segment of each trajectory, after selections and joins too.

    Args:
        trajectories: of a recording, whole or selected, or several joined.

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
        trajectories: of a recording.
        names: labels that tell groups apart; run and particle unless given.

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
    """Positions in pixels, as the file of a recording has them; in images, y down.

    Args:
        recording: whose scale and flip are undone; whole or selected.
        positions: observed ones, or those of a model [L].

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


JUMPS: Mapping[str, float] = {"px": 40.0, "um": 15.0}
"""Displacement from one row to the next that no swimmer makes, by unit of length.

Where the unit is unknown, a track is split at steps far beyond its own: `jump_limit`.
"""

BEYOND, ORDINARY, LEAST_STEPS = 20.0, 0.95, 20
"""Without a unit, a jump is so many times the quantile `ORDINARY` of the steps, if
there are that many of them."""


def jump_limit(
    unit: str, jump: float | None, steps: Float64[np.ndarray, " step"]
) -> float:
    """Displacement beyond which a track is split [unit of length].

    Args:
        unit: of length.
        jump: what the user states, if anything.
        steps: displacements of the track from row to row [unit of length].
    """
    if jump is not None:
        return jump
    if unit in JUMPS:
        return JUMPS[unit]
    if len(steps) < LEAST_STEPS:
        return np.inf
    ordinary = float(np.quantile(steps, ORDINARY))
    return BEYOND * ordinary if ordinary > 0 else np.inf


def segments(
    tracks: Tracks, particle: Particle, *, jump: float | None, gap: int
) -> Int64[np.ndarray, " row"]:
    """Number of the segment of each row of a particle, 0 first.

    Those of the file are kept where it has them.

    Args:
        tracks: of the recording.
        particle: one of its particles.
        jump: limit of a displacement [unit of length]; of `JUMPS` unless given.
        gap: greatest step in frames; without frames, of the median step in time.
    """
    if tracks.segment is not None:
        return tracks.segment[particle.rows]
    observed = np.flatnonzero(particle.observed)
    steps = np.linalg.norm(np.diff(particle.positions[observed], axis=0), axis=1)
    limit = jump_limit(tracks.length_unit, jump, steps)
    cuts = (steps > limit) | (_frames_between(tracks, particle, observed) > gap)
    numbers = np.zeros(len(particle.rows), np.int64)
    numbers[observed[1:][cuts]] = 1
    return np.cumsum(numbers)


def _frames_between(
    tracks: Tracks, particle: Particle, observed: np.ndarray
) -> Float64[np.ndarray, " step"]:
    """Frames from each seen row to the next."""
    if tracks.frame is not None:
        return np.diff(tracks.frame[particle.rows[observed]]).astype(np.float64)
    steps = np.diff(particle.times[observed])
    return np.round(steps / np.median(steps)) if len(steps) else steps
