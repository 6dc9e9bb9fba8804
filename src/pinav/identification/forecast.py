"""Open-loop rollouts on the held-out part of a track: errors and bands."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Int

from pinav.actuation import HeldProgramme
from pinav.evaluation import normal_quantile
from pinav.identification.fit import TrackFit
from pinav.identification.kalman import Disturbance, transitions
from pinav.identification.models import NAMES, RESPONSES, SwitchedResponse
from pinav.identification.tracks import Track, commands_of, round_up_to
from pinav.trajectories import Trajectory

HORIZONS = (1.0, 5.0, 10.0, 30.0)
"""Seconds over which errors are reported."""

STRIDE = 5.0
"""Seconds between the starts of two rollouts."""

Displacement = Callable[[Trajectory], Float[np.ndarray, "time 2"]]
"""Predicted path of a segment, up to a constant [L]."""


class Rollouts(eqx.Module):
    """Rollouts of one horizon over a track, each from an observed position.

    Attributes:
        piece: in which segment each starts.
        first: sample at which it starts.
        last: sample at which it ends.
    """

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
    """What a path of each segment adds from the start of each rollout to its end."""
    paths = [path(piece) for piece in track.pieces]
    places = zip(rollouts.piece, rollouts.first, rollouts.last, strict=True)
    rows = [paths[index][b] - paths[index][a] for index, a, b in places]
    return np.stack(rows) if rows else np.zeros((0, paths[0].shape[1]))


class Errors(eqx.Module):
    """End-point errors of rollouts.

    Attributes:
        distance: between predicted and observed end [L].
        path: length of the observed path [L].
    """

    distance: Float[np.ndarray, " rollout"]
    path: Float[np.ndarray, " rollout"]

    @property
    def relative(self) -> float:
        """Median distance over path length; NaN without rollouts."""
        ratio = self.distance / np.maximum(self.path, 1e-12)
        return float(np.median(ratio)) if len(ratio) else float("nan")

    @property
    def rollouts(self) -> int:
        """Number of rollouts."""
        return len(self.distance)

    @property
    def median(self) -> float:
        """Median distance [L]; NaN without rollouts."""
        return float(np.median(self.distance)) if len(self.distance) else float("nan")


def errors(track: Track, rollouts: Rollouts, displacement: Displacement) -> Errors:
    """Errors of a model that predicts displacements, whatever the start.

    The path is the polygon of the observed positions, frame by frame.
    """
    observed = changes_along(track, rollouts, lambda piece: piece.states)
    miss = observed - changes_along(track, rollouts, displacement)
    return Errors(np.hypot(*miss.T), rollouts.lengths(track))


def _cumulated_length(piece: Trajectory) -> Float[np.ndarray, "time 1"]:
    # The noise of the frames lengthens this path, and that of other models alike.
    steps = np.hypot(*np.diff(piece.states, axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])[:, None]


def programme_of(piece: Trajectory) -> HeldProgramme:
    """The commands of a segment; none count as a frequency of 0.

    The last one is held for as many times more as make the number of times round, so
    that what is compiled for one segment serves others.
    """
    size = LEAST_SIZE
    while size < len(piece.times):
        size *= 2
    more = size - len(piece.times)
    # Lengths are powers of two, so that few programs are compiled; what follows the
    # last command reaches no sample.
    later = piece.times[-1] + 1.0 + np.arange(more)
    held = [jnp.asarray(np.pad(v, (0, more), "edge")) for v in commands_of(piece)]
    return HeldProgramme(jnp.asarray(np.concatenate([piece.times, later])), *held)


LEAST_SIZE = 2048
"""Samples that are compiled for at least; for longer segments, twice as many and so
on, since a program takes longer to compile than to run on twice the samples."""


def cycles(fit: TrackFit, piece: Trajectory) -> Float[np.ndarray, "time 2"]:
    """Integral of the delayed response along the heading."""
    index = RESPONSES.index(fit.candidate.response)
    with jax.enable_x64(new_val=True):
        programme, drive = programme_of(piece), jnp.asarray(fit.theta[:4])
        # The response is chosen by its place, in one compiled program for all of them.
        integral = _cycles(programme, jnp.asarray(index), drive)
    return np.asarray(integral)[: len(piece.times)]


@eqx.filter_jit
def _cycles(programme: HeldProgramme, index: Array, drive: Array) -> Array:
    corner, residual, delay, lag = drive
    response = SwitchedResponse(index, corner, residual)
    times = programme.times - delay
    return programme.lagged_integral(response, times, jnp.exp(lag))


def path_of(fit: TrackFit) -> Displacement:
    """Displacements by gain and drift alone."""

    def displacement(piece: Trajectory) -> Float[np.ndarray, "time 2"]:
        along = cycles(fit, piece) @ fit.gain.T
        return along + np.outer(piece.times - piece.times[0], fit.drift)

    return displacement


def cache_by_segment(displacement: Displacement) -> Displacement:
    """The same displacement, computed once for each segment that lives as long."""
    known: dict[int, Float[np.ndarray, "time 2"]] = {}

    def path(piece: Trajectory) -> Float[np.ndarray, "time 2"]:
        if id(piece) not in known:
            known[id(piece)] = displacement(piece)
        return known[id(piece)]

    return path


class FrameJitter(eqx.Module):
    """Scatter of single frames about the mean path, along and across the heading.

    Attributes:
        driven: variances along and across while rolling [L²].
        still: variance at rest, along any axis [L²].
    """

    driven: Float[np.ndarray, "2"]
    still: float

    @property
    def deviation(self) -> float:
        """Root mean square of both axes: the noise of a single position [L]."""
        return float(np.sqrt(self.driven.mean()))

    @classmethod
    def of(cls, track: Track, displacement: Displacement) -> "FrameJitter":
        """From what a model leaves, about its running mean over a block."""
        along, across, rest = [], [], []
        for piece in track.pieces:
            left = piece.states - displacement(piece)
            scatter = left - _running_mean(piece.times, left, track.width)
            frequency, heading = commands_of(piece)
            on = frequency > 0
            cosine, sine = np.cos(heading), np.sin(heading)
            along.append((scatter[:, 0] * cosine + scatter[:, 1] * sine)[on])
            across.append((scatter[:, 1] * cosine - scatter[:, 0] * sine)[on])
            rest.append(scatter[~on].ravel())
        variances = [_mean_square(np.concatenate(v)) for v in (along, across, rest)]
        driven = np.array(variances[:2])
        still = variances[2] if sum(map(len, rest)) else float(driven.min())
        return cls(driven if driven.any() else np.full(2, still), still)

    def variance(self, piece: Trajectory) -> Float[np.ndarray, "time 2"]:
        """Variance of each coordinate at each sample."""
        frequency, heading = commands_of(piece)
        squares = np.stack([np.cos(heading), np.sin(heading)], axis=1) ** 2
        along, across = self.driven
        rolling = along * squares + across * (1 - squares)
        return np.where(frequency[:, None] > 0, rolling, self.still)


def _mean_square(values: np.ndarray) -> float:
    return float(np.mean(values**2)) if len(values) else 0.0


def _running_mean(times: np.ndarray, values: np.ndarray, width: float) -> np.ndarray:
    total = np.concatenate([np.zeros((1, 2)), np.cumsum(values, axis=0)])
    low = np.searchsorted(times, times - width / 2)
    high = np.searchsorted(times, times + width / 2, side="right")
    return (total[high] - total[low]) / (high - low)[:, None]


class Forecast(eqx.Module):
    """A model's path through a segment, with what is uncertain about it.

    Attributes:
        piece: the segment.
        path: displacement from its first sample [L].
        slopes: of the displacement, by the unknowns of gain, drift and drive.
        covariance: of those unknowns.
        beyond: standard deviation of the displacement that another form of the
            response would add above the frequencies that were fitted [L].
        frame: variance of a single frame about the mean path [L²].
        disturbance: the noise.
        turned: integral of the response along the heading, x + iy [cycles].
    """

    piece: Trajectory
    path: Float[np.ndarray, "time 2"]
    slopes: Float[np.ndarray, "time 2 unknown"]
    covariance: Float[np.ndarray, "unknown unknown"]
    beyond: Float[np.ndarray, "time 2"]
    frame: Float[np.ndarray, "time 2"]
    disturbance: Disturbance
    turned: Complex[np.ndarray, " time"]

    @classmethod
    def of(cls, piece: Trajectory, fit: TrackFit, jitter: FrameJitter) -> "Forecast":
        """The forecast of a fit, computed once for all rollouts of a segment."""
        path = path_of(fit)(piece)
        slopes, covariance = _slopes(piece, fit, path)
        frame = jitter.variance(piece)
        beyond = _beyond(piece, fit)
        noise = (fit.wandering or fit).disturbance
        turned = cycles(fit, piece) @ np.array([1.0, 1.0j])
        return cls(piece, path, slopes, covariance, beyond, frame, noise, turned)

    def rollout(self, first: int, last: int) -> Float[np.ndarray, "sample 2"]:
        """Positions from the observed one at sample `first` on [L]."""
        path = self.path[first : last + 1]
        return self.piece.states[first] + path - path[0]

    def variance(self, first: int, last: int) -> Float[np.ndarray, "sample 2"]:
        """Of a rollout: disturbance, unknowns, response, jitter at both ends [L²]."""
        samples = slice(first, last + 1)
        # A rollout begins at an observed position: what the parameters moved before it
        # cancels.
        slopes = self.slopes[samples] - self.slopes[first]
        unknown = np.einsum("tap,pq,taq->ta", slopes, self.covariance, slopes)
        response = (self.beyond[samples] - self.beyond[first]) ** 2
        frame = self.frame[samples]
        wandering = self._wandering(samples)[:, None]
        # The first frame errs, too, as the rollout begins there.
        return wandering + unknown + response + frame + frame[:1]

    def _wandering(self, samples: slice) -> Float[np.ndarray, " sample"]:
        """What the disturbance adds from a start without knowledge of it."""
        frequency, _ = commands_of(self.piece)
        intervals = np.diff(self.piece.times[samples])
        more = (0, round_up_to(len(intervals), LEAST_SIZE) - len(intervals))
        with jax.enable_x64(new_val=True):
            variances = _wandering_variances(
                jnp.asarray(np.pad(intervals, more, constant_values=1.0)),
                jnp.asarray(np.pad(frequency[samples][:-1], more)),
                jnp.asarray(np.pad(np.diff(self.turned[samples]), more)),
                self.disturbance,
            )
        return np.concatenate([[0.0], np.asarray(variances)[: len(intervals)]])


@eqx.filter_jit
def _wandering_variances(
    intervals: Array, frequency: Array, turned: Array, disturbance: Disturbance
) -> Array:
    """Variance of the way after each interval, velocities and gain unknown at first."""
    strength = disturbance.strength(frequency)
    steps = transitions(intervals, strength, disturbance, turned)

    def step(spread: Array, inputs: tuple[Array, Array]) -> tuple[Array, Array]:
        matrix, noise = inputs
        spread = matrix @ spread @ matrix.conj().T + noise.astype(matrix.dtype)
        return spread, spread[0, 0].real

    # The position is where the rollout begins, the velocities are stationary.
    unknown = jnp.diag(jnp.array([0.0, 1.0, 1.0, 1.0])).astype(turned.dtype)
    return jax.lax.scan(step, unknown, (steps.matrix, steps.noise))[1]


def _slopes(
    piece: Trajectory, fit: TrackFit, path: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Of a displacement by each unknown, and the covariance of the unknowns."""
    known = fit.wandering or fit
    learned = known.candidate.learned
    drive = [name for name in NAMES[:4] if name in learned]
    elapsed = piece.times - piece.times[0]
    gains = np.einsum("gab,tb->tag", fit.candidate.matrices(), cycles(fit, piece))
    drifts = np.einsum("ga,t->tag", fit.candidate.velocities(), elapsed)
    columns = [_drive_slope(piece, fit, path, name)[:, :, None] for name in drive]
    places = [learned.index(name) for name in drive]
    places += list(range(len(learned), len(known.covariance)))
    slopes = np.concatenate([*columns, gains, drifts], axis=2)
    return slopes, known.covariance[np.ix_(places, places)]


def _drive_slope(
    piece: Trajectory, fit: TrackFit, path: np.ndarray, name: str
) -> np.ndarray:
    step = 1e-3
    theta = np.array(fit.theta)
    theta[NAMES.index(name)] += step
    # A forward difference is enough: a band needs its slope to some per mille.
    moved = path_of(eqx.tree_at(lambda f: f.theta, fit, theta))(piece)
    return (moved - path) / step


DISCREPANCY = 0.25
"""Standard deviation of the slope of the response above the fitted frequencies, in
slopes at rest: between none and the whole of it, all are seen. Chosen on five sessions
and half of the other recordings, judged on the rest (docs/identification.md)."""


def _beyond(piece: Trajectory, fit: TrackFit) -> Float[np.ndarray, "time 2"]:
    """Displacement by the excess of the frequency over all that was fitted [L]."""
    frequency, heading = commands_of(piece)
    # Beyond the fastest command of the fit the response is extrapolated.
    excess = np.maximum(frequency - fit.fastest, 0.0)
    drive = excess[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    steps = drive[:-1] * np.diff(piece.times)[:, None]
    along = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return DISCREPANCY * along @ fit.gain.T


class Coverage(eqx.Module):
    """How often rollouts stayed within their nominal band.

    Attributes:
        inside: share of all coordinates at all samples after the start.
        at_end: the same at the last sample alone.
        rollouts: their number.
    """

    inside: float
    at_end: float
    rollouts: int


def coverage(
    track: Track, rollouts: Rollouts, fit: TrackFit, jitter: FrameJitter
) -> Coverage:
    """Coverage of nominal bands of 90 % along each axis."""
    forecasts = [Forecast.of(piece, fit, jitter) for piece in track.pieces]
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
