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
