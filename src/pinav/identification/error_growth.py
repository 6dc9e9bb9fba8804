"""Error of open-loop rollouts over their length, beside what their bands promise."""

import math

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from pinav.identification.forecast import (
    STRIDE,
    Displacement,
    Forecast,
    Predictor,
)
from pinav.identification.tracks import Track

LENGTHS = np.array([0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0])
"""Lengths of rollouts at which errors are given [s]."""

RADIUS_90 = math.sqrt(-2 * math.log(0.1))
"""Of the circle that holds 90 % of a normal number in the plane, in its deviations."""


class ErrorGrowth(eqx.Module):
    """End-point errors of rollouts by their length.

    Attributes:
        lengths: of the rollouts that fit into the track [s].
        errors: 10 % quantile, median and 90 % quantile over rollouts [L].
        reference: median of another model [L].
        promised: radius within which the model's own bands expect 90 % of the ends,
            median over rollouts [L].
        rollouts: number of rollouts of each length.
    """

    lengths: Float[np.ndarray, " length"]
    errors: Float[np.ndarray, "3 length"]
    reference: Float[np.ndarray, " length"]
    promised: Float[np.ndarray, " length"]
    rollouts: Int[np.ndarray, " length"]

    @classmethod
    def of(
        cls, track: Track, predictor: Predictor, reference: Displacement
    ) -> "ErrorGrowth":
        """Errors on a track; rollouts start every `STRIDE` seconds of each segment.

        Args:
            track: track that the fit has not seen.
            predictor: fitted swimmer with its bands.
            reference: displacements of another model.
        """
        rows = [np.zeros((0, 3, len(LENGTHS)))]
        for piece in track.pieces:
            forecast, other = predictor.forecast(piece), reference(piece)
            starts = np.arange(piece.times[0], piece.times[-1] - LENGTHS[0], STRIDE)
            for first in np.searchsorted(piece.times, starts - 1e-9):
                rows.append(_growth(forecast, other, int(first))[None])
        table = np.concatenate(rows)
        counts = np.isfinite(table[:, 0]).sum(axis=0)
        table, counts = table[:, :, counts > 0], counts[counts > 0]
        quantiles = np.nanquantile(table[:, 0], (0.1, 0.5, 0.9), axis=0)
        others = np.nanmedian(table[:, 1:], axis=0)
        return cls(LENGTHS[: len(counts)], quantiles, others[0], others[1], counts)


def _growth(
    forecast: Forecast, other: Float[np.ndarray, "time 2"], first: int
) -> Float[np.ndarray, "3 length"]:
    """Error, that of another model, and the promised one; NaN beyond the segment."""
    times, positions = forecast.piece.times, forecast.piece.states
    # Times of frames carry rounding: one at the very end of a length counts.
    ends = np.searchsorted(times, times[first] + LENGTHS - 1e-9)
    fits = ends < len(times)
    ends = ends[fits]
    growth = np.full((3, len(LENGTHS)), np.nan)
    moved = positions[ends] - positions[first]
    for row, path in enumerate((forecast.path, other)):
        growth[row, fits] = np.hypot(*(moved - (path[ends] - path[first])).T)
    variance = forecast.variance(first, int(ends[-1]))[ends - first]
    # The mean of both variances: bands are nearly round, and a figure shows one line.
    growth[2, fits] = RADIUS_90 * np.sqrt(variance.mean(axis=1))
    return growth
