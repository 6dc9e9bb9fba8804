"""Where a particle's track is cut: at jumps of the tracker and at gaps.

What lies on either side of a cut may be two particles, and is never bridged.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float64, Int64

from pinav.recordings.particles import Particle
from pinav.recordings.rows import Tracks

JUMPS: Mapping[str, float] = {"px": 40.0, "um": 15.0}
"""Displacement from one row to the next that no swimmer makes, by unit of length.

Where the unit is unknown, nothing is split unless the limit is given.
"""


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
    limit = JUMPS.get(tracks.length_unit, np.inf) if jump is None else jump
    seen = np.flatnonzero(particle.seen)
    steps = np.linalg.norm(np.diff(particle.positions[seen], axis=0), axis=1)
    cuts = (steps > limit) | (_frames_between(tracks, particle, seen) > gap)
    numbers = np.zeros(len(particle.rows), np.int64)
    numbers[seen[1:][cuts]] = 1
    return np.cumsum(numbers)


def _frames_between(
    tracks: Tracks, particle: Particle, seen: np.ndarray
) -> Float64[np.ndarray, " step"]:
    """Frames from each seen row to the next."""
    if tracks.frame is not None:
        return np.diff(tracks.frame[particle.rows[seen]]).astype(np.float64)
    steps = np.diff(particle.times[seen])
    return np.round(steps / np.median(steps)) if len(steps) else steps
