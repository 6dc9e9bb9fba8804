"""Open-loop rollouts on a track: errors, coverage of bands, and what figures show."""

import math

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from pinav.evaluation import normal_quantile
from pinav.fitting import EvidenceFit
from pinav.identification.estimates import drift_of, speeds
from pinav.identification.forecast import (
    Displacement,
    DrivenSwimmer,
    Forecast,
    Predictor,
)
from pinav.identification.tracks import Track, commands_of
from pinav.recordings import image_positions
from pinav.recordings.drive import pairs_apart
from pinav.trajectories import Trajectories, Trajectory

HORIZONS = (1.0, 5.0, 10.0, 30.0)
"""Seconds over which errors are reported."""

STRIDE = 5.0
"""Seconds between the starts of two rollouts."""


class Rollouts(eqx.Module):
    """Rollouts of one horizon over a track, each from an observed position."""

    piece: Int[np.ndarray, " rollout"]
    first: Int[np.ndarray, " rollout"]
    last: Int[np.ndarray, " rollout"]

    @classmethod
    def of(cls, track: Track, horizon: float) -> "Rollouts":
        """Starts every `STRIDE` seconds of each segment, where the horizon fits."""
        places = []
        for index, piece in enumerate(track.pieces):
            times = piece.times
            # Times of a camera carry rounding: a rollout that just fits is not lost.
            starts = np.arange(times[0], times[-1] - horizon + 1e-9, STRIDE)
            first = np.searchsorted(times, starts - 1e-9)
            last = np.searchsorted(times, times[first] + horizon - 1e-9)
            fits = (last < len(times)) & (first < last)
            places += [
                (index, a, b) for a, b in zip(first[fits], last[fits], strict=True)
            ]
        rows = np.array(places, np.int64).reshape(-1, 3)
        return cls(*rows.T)

    def __len__(self) -> int:
        return len(self.first)

    def lengths(self, track: Track) -> Float[np.ndarray, " rollout"]:
        """Lengths of the observed paths, polygons from frame to frame [L]."""
        return changes_along(track, self, _cumulated_length)[:, 0]


def changes_along(
    track: Track, rollouts: Rollouts, path: Displacement
) -> Float[np.ndarray, "rollout column"]:
    """Change of a path of each segment from the start of each rollout to its end."""
    paths = [path(piece) for piece in track.pieces]
    places = zip(rollouts.piece, rollouts.first, rollouts.last, strict=True)
    rows = [paths[index][b] - paths[index][a] for index, a, b in places]
    return np.stack(rows) if rows else np.zeros((0, paths[0].shape[1]))


class Errors(eqx.Module):
    """End-point errors of rollouts of one length; NaN without any; `median` is in [L].

    Attributes:
        relative: median of the distance over the length of the observed path.
    """

    relative: float
    median: float
    rollouts: int

    @classmethod
    def of(
        cls,
        distance: Float[np.ndarray, " rollout"],
        path: Float[np.ndarray, " rollout"],
    ) -> "Errors":
        """The errors of rollouts."""
        if not len(distance):
            return cls(float("nan"), float("nan"), 0)
        relative = float(np.median(distance / np.maximum(path, 1e-12)))
        return cls(relative, float(np.median(distance)), len(distance))


def errors(track: Track, rollouts: Rollouts, displacement: Displacement) -> Errors:
    """Errors of predictions; the path is the polygon of observed positions."""
    observed = changes_along(track, rollouts, lambda piece: piece.states)
    miss = observed - changes_along(track, rollouts, displacement)
    return Errors.of(np.hypot(*miss.T), rollouts.lengths(track))


def _cumulated_length(piece: Trajectory) -> Float[np.ndarray, "time 1"]:
    # The noise of the frames lengthens this path, and that of other models alike.
    steps = np.hypot(*np.diff(piece.states, axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])[:, None]


class Coverage(eqx.Module):
    """Shares of coordinates within the nominal band: at all samples, at the end."""

    inside: float
    at_end: float
    rollouts: int


def coverage(track: Track, rollouts: Rollouts, predictor: Predictor) -> Coverage:
    """Coverage of nominal bands of 90 % along each axis."""
    forecasts = [predictor.forecast(piece) for piece in track.pieces]
    inside, ends = [], []
    for index, a, b in zip(rollouts.piece, rollouts.first, rollouts.last, strict=True):
        forecast = forecasts[index]
        miss = track.pieces[index].states[a : b + 1] - forecast.rollout(int(a), int(b))
        sd = np.sqrt(forecast.variance(int(a), int(b)))
        within = np.abs(miss[1:]) <= normal_quantile(0.9) * sd[1:]
        inside.append(within.ravel())
        ends.append(within[-1])
    if not inside:
        return Coverage(float("nan"), float("nan"), 0)
    return Coverage(
        float(np.mean(np.concatenate(inside))), float(np.mean(ends)), len(ends)
    )


LENGTHS = np.array([0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0])
"""Lengths of rollouts at which errors are given [s]."""

RADIUS_90 = math.sqrt(-2 * math.log(0.1))
"""Radius of the circle that holds 90 % of a normal point in the plane [sd]."""


class ErrorGrowth(eqx.Module):
    """End-point errors of rollouts by their length.

    Attributes:
        errors: 10 % quantile, median and 90 % quantile over rollouts [L].
        reference: median of another model [L].
        promised: radius within which the model's bands expect 90 % of the ends, median
            over rollouts [L].
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
        """Errors on a track; rollouts start every `STRIDE` seconds of each segment."""
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


STACKED_HORIZON = 10.0
"""Length of the rollouts that tell the weight of an average [s]."""

PRIOR_ROLLOUTS = 15
"""Rollouts that the wish for equal weights counts as."""


def stacking_weight(track: Track, ours: Displacement, theirs: Displacement) -> float:
    """Weight of one model beside another one, from 0 to 1.

    The ends of rollouts, relative to the length of the path, are fitted by least
    squares. The training part flatters the richer model, and few rollouts say little:
    weights are drawn to one half, which they are without any rollout.
    """
    rollouts = Rollouts.of(track, STACKED_HORIZON)
    other = changes_along(track, rollouts, theirs)
    length = np.maximum(rollouts.lengths(track), 1e-12)[:, None]
    apart = (changes_along(track, rollouts, ours) - other) / length
    observed = changes_along(track, rollouts, lambda piece: piece.states)
    wanted = (observed - other) / length
    squares = float(np.sum(apart**2))
    if squares == 0:
        return 0.5
    prior = PRIOR_ROLLOUTS * squares / len(apart)
    weight = (np.sum(apart * wanted) + 0.5 * prior) / (squares + prior)
    return float(np.clip(weight, 0.0, 1.0))


def stack(ours: Displacement, theirs: Displacement, weight: float) -> Displacement:
    """The average of two paths; `weight` is that of the first."""
    return lambda piece: weight * ours(piece) + (1 - weight) * theirs(piece)


SHOWN_ROLLOUTS = 6
"""Rollouts that are drawn one by one; more would be a tangle."""


class ShownRollout(eqx.Module):
    """A rollout on the held-out part, with the sd of its end along each axis [L]."""

    start: float
    observed: Float[np.ndarray, "sample 2"]
    predicted: Float[np.ndarray, "sample 2"]
    sd: Float[np.ndarray, "2"]


class Paths(eqx.Module):
    """The held-out part of a track, with some rollouts."""

    whole: tuple[Float[np.ndarray, "_ 2"], ...]
    rollouts: tuple[ShownRollout, ...]

    @classmethod
    def of(cls, track: Track, predictor: Predictor, rollouts: Rollouts) -> "Paths":
        """Some rollouts of a track."""
        forecasts = [predictor.forecast(piece) for piece in track.pieces]
        count = min(SHOWN_ROLLOUTS, len(rollouts))
        shown = []
        for place in np.linspace(0, len(rollouts) - 1, count).astype(int):
            forecast = forecasts[int(rollouts.piece[place])]
            first, last = int(rollouts.first[place]), int(rollouts.last[place])
            shown.append(
                ShownRollout(
                    start=float(forecast.piece.times[first]),
                    observed=forecast.piece.states[first : last + 1],
                    predicted=forecast.rollout(first, last),
                    sd=np.sqrt(forecast.variance(first, last)[-1]),
                )
            )
        return cls(tuple(piece.states for piece in track.pieces), tuple(shown))

    def in_image(self, recording: Trajectories) -> "Paths | None":
        """The same in pixels of the image, y down; none where there was no image."""
        if recording.provenance.get("positions", {}).get("unit in the file") != "px":
            return None
        whole = tuple(image_positions(recording, path) for path in self.whole)
        rollouts = tuple(
            ShownRollout(
                start=rollout.start,
                observed=image_positions(recording, rollout.observed),
                predicted=image_positions(recording, rollout.predicted),
                sd=np.abs(image_positions(recording, rollout.sd)),
            )
            for rollout in self.rollouts
        )
        return Paths(whole, rollouts)


class SpeedLaw(eqx.Module):
    """Speed [L T⁻¹] by commanded frequency [Hz], observed and fitted.

    Attributes:
        speed: observed along the turned heading in each block.
        sd: standard deviation of the fitted speed.
    """

    frequency: Float[np.ndarray, " block"]
    speed: Float[np.ndarray, " block"]
    places: Float[np.ndarray, " place"]
    fitted: Float[np.ndarray, " place"]
    sd: Float[np.ndarray, " place"]

    @classmethod
    def of(cls, track: Track, fit: EvidenceFit) -> "SpeedLaw":
        """The law of a fit to all of a track."""
        frequency, speed = [], []
        driven = DrivenSwimmer.of(fit.model)
        for piece in track.pieces:
            along = driven.displacements(piece) @ driven.gain.T
            drift = np.outer(piece.times - piece.times[0], drift_of(fit.model))
            some = slice(None, None, max(1, len(piece.times) // 400))
            first, last = (i[some] for i in pairs_apart(piece.times, track.width))
            step, observed = along[last] - along[first], piece.states - drift
            moved = observed[last] - observed[first]
            size = np.hypot(*step.T)
            interval = piece.times[last] - piece.times[first]
            rolling = size > 0
            ahead = (moved * step).sum(axis=1) / np.where(rolling, size, 1)
            speed.append(ahead[rolling] / interval[rolling])
            frequency.append(commands_of(piece)[0][first][rolling])
        several = np.concatenate(frequency)
        places = np.linspace(0, max(float(several.max()), 1e-3), 60)
        law = speeds(fit, places)
        fitted, sd = (np.array([getattr(v, n) for v in law]) for n in ("value", "sd"))
        return cls(several, np.concatenate(speed), places, fitted, sd)
