"""The arrays behind the figures of a track."""

import numpy as np

from pinav.identification import (
    Forecast,
    FrameJitter,
    Rollouts,
    Selection,
    Track,
    TrackFit,
)
from pinav.identification.forecast import cycles
from pinav.identification.tracks import commands_of


def figure_arrays(
    selection: Selection, whole: TrackFit, jitter: FrameJitter, rollouts: Rollouts
) -> dict[str, np.ndarray]:
    """What the figures of a track need."""
    held_out, fit = selection.held_out, selection.best
    arrays: dict[str, np.ndarray] = {}
    for index, piece in enumerate(held_out.pieces):
        arrays[f"observed/{index}"] = piece.states
    ends = zip(rollouts.piece, rollouts.first, rollouts.last, strict=True)
    forecasts = [Forecast.of(piece, fit, jitter) for piece in held_out.pieces]
    for index, (segment, a, b) in enumerate(ends):
        arrays[f"predicted/{index}"] = forecasts[segment].rollout(int(a), int(b))
        arrays[f"sd/{index}"] = np.sqrt(forecasts[segment].variance(int(a), int(b))[-1])
    if whole.candidate.gains:
        arrays |= _speed_law(selection.track, whole)
    return arrays


def _speed_law(track: Track, fit: TrackFit) -> dict[str, np.ndarray]:
    """Speed along the turned heading over blocks, and the response with its sd."""
    frequency, speed = [], []
    for piece in track.pieces:
        along = cycles(fit, piece) @ fit.gain.T
        drift = np.outer(piece.times - piece.times[0], fit.drift)
        later = np.searchsorted(piece.times, piece.times + track.width)
        index = np.arange(0, len(later), max(1, len(later) // 400))
        index = index[later[index] < len(piece.times)]
        later = later[index]
        step, observed = along[later] - along[index], (piece.states - drift)
        moved = observed[later] - observed[index]
        size = np.hypot(*step.T)
        interval = piece.times[later] - piece.times[index]
        rolling = size > 0
        speed.append(((moved * step).sum(axis=1) / np.where(rolling, size, 1))[rolling])
        speed[-1] = speed[-1] / interval[rolling]
        frequency.append(commands_of(piece)[0][index][rolling])
    places = np.linspace(0, max(float(np.concatenate(frequency).max()), 1e-3), 60)
    fitted, sd = fit.speed(places)
    return {
        "law/frequency": np.concatenate(frequency),
        "law/speed": np.concatenate(speed),
        "law/places": places,
        "law/fitted": fitted,
        "law/sd": sd,
    }
