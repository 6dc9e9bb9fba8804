"""The arrays behind the figures of a track."""

import numpy as np

from pinav.fitting import EvidenceFit
from pinav.forces import RollingPropulsion
from pinav.identification import (
    ErrorGrowth,
    Rollouts,
    Selection,
    Track,
    least_squares,
)
from pinav.identification.estimates import drift_of, gain_of
from pinav.identification.estimates import speed as speed_by_frequency
from pinav.identification.forecast import cycles
from pinav.identification.tracks import commands_of

SHOWN_ROLLOUTS = 6
"""Rollouts that are drawn one by one; more would be a tangle."""


def figure_arrays(
    selection: Selection, whole: EvidenceFit, rollouts: Rollouts
) -> dict[str, np.ndarray]:
    """What the figures of a track need.

    Args:
        selection: of the track.
        whole: the chosen candidate, fitted to all of it.
        rollouts: on the held-out part; a few of them are kept.
    """
    held_out, predictor = selection.held_out, selection.predictor
    arrays: dict[str, np.ndarray] = {}
    count = min(SHOWN_ROLLOUTS, len(rollouts))
    forecasts = [predictor.forecast(piece) for piece in held_out.pieces]
    shown = np.linspace(0, len(rollouts) - 1, count).astype(int)
    for index, place in enumerate(shown):
        segment = int(rollouts.piece[place])
        first, last = int(rollouts.first[place]), int(rollouts.last[place])
        piece, forecast = held_out.pieces[segment], forecasts[segment]
        arrays[f"start/{index}"] = np.array(piece.times[first])
        arrays[f"observed/{index}"] = piece.states[first : last + 1]
        arrays[f"predicted/{index}"] = forecast.rollout(first, last)
        arrays[f"sd/{index}"] = np.sqrt(forecast.variance(first, last)[-1])
    for index, piece in enumerate(held_out.pieces):
        arrays[f"whole/{index}"] = piece.states
    reference = least_squares(selection.train).displacement()
    growth = ErrorGrowth.of(held_out, predictor, reference)
    for name in ("lengths", "errors", "reference", "promised"):
        arrays[f"growth/{name}"] = getattr(growth, name)
    if isinstance(whole.model.propulsion, RollingPropulsion):
        arrays |= _speed_law(selection.track, whole)
    return arrays


def _speed_law(track: Track, fit: EvidenceFit) -> dict[str, np.ndarray]:
    """Speed along the turned heading over blocks, and the response with its sd."""
    frequency, speed = [], []
    for piece in track.pieces:
        along = cycles(fit.model, piece) @ gain_of(fit.model).T
        drift = np.outer(piece.times - piece.times[0], drift_of(fit.model))
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
    fitted, sd = speed_by_frequency(fit, places)
    return {
        "law/frequency": np.concatenate(frequency),
        "law/speed": np.concatenate(speed),
        "law/places": places,
        "law/fitted": fitted,
        "law/sd": sd,
    }
