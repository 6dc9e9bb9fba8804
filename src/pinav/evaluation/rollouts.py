r"""Errors of rollouts over time, from the start or from observed positions.

A rollout has diverged from the first time at which its position is not finite or
farther from the truth than the extent of the domain; its error is infinite from then
on. A quantile is the smallest value that the given fraction of trajectories does not
exceed, so that infinite errors stay infinite and nothing is interpolated.

One rollout of a whole film adds up all that wanders: its error says how long the film
is. Rollouts of seconds say what a model predicts.
"""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from pinav.dynamics import AbstractDynamics
from pinav.errors import InputError
from pinav.evaluation.force_fields import extent
from pinav.evaluation.scores import predict
from pinav.trajectories import Trajectories, Trajectory, local_polynomial

MEDIAN, HIGH = 0.5, 0.9
BINS = 60
"""Intervals of time in which errors are pooled, at most."""


class RolloutErrors(eqx.Module):
    """Position errors of rollouts, one row for each trajectory.

    Attributes:
        elapsed: time since the start [T].
        distance: distance to the observed position [L]; infinite once diverged.
        path: way travelled since the start [L], along the smoothed observations.
        scored: where a position was observed and is scored.
    """

    elapsed: Float[np.ndarray, "trajectory time"]
    distance: Float[np.ndarray, "trajectory time"]
    path: Float[np.ndarray, "trajectory time"]
    scored: Bool[np.ndarray, "trajectory time"]
    extent: float


def position_errors(
    predictions: Float[np.ndarray, "trajectory time state"],
    trajectories: Trajectories,
    *,
    domain: float | None = None,
) -> RolloutErrors:
    """Errors of the predicted positions against the observed ones.

    Raises:
        InputError: nothing is left to score.
    """
    dim = trajectories.dim
    scored = trajectories.seen
    if not scored.any():
        raise InputError(
            "rollout errors: no observed position is left to score; give longer "
            "trajectories"
        )
    domain = extent(trajectories) if domain is None else domain
    offsets = predictions[..., :dim] - trajectories.states[..., :dim]
    distance = np.linalg.norm(offsets, axis=-1)
    lost = scored & ~(distance <= domain)
    diverged = np.logical_or.accumulate(lost, axis=1)
    return RolloutErrors(
        elapsed=trajectories.times - trajectories.times[:, :1],
        distance=np.where(diverged, np.inf, distance),
        path=_paths(trajectories, dim),
        scored=scored,
        extent=domain,
    )


def _paths(trajectories: Trajectories, dim: int) -> np.ndarray:
    """Way along local cubics through the observations: noise hardly lengthens it."""
    ways = np.zeros(trajectories.times.shape)
    for way, piece in zip(ways, trajectories, strict=True):
        is_observed = np.asarray(piece.observed[:, :dim].all(-1))
        if is_observed.sum() < 2:
            way[:] = np.nan
            continue
        smooth = [
            local_polynomial(piece.times, piece.states[:, i], is_observed)
            for i in range(dim)
        ]
        steps = np.linalg.norm(np.diff(np.stack(smooth, axis=1), axis=0), axis=1)
        way[1 : len(steps) + 1] = np.cumsum(steps)
        way[len(steps) + 1 :] = way[len(steps)]
    return ways


def quantile(values: Float[np.ndarray, " any"], level: float) -> float:
    """Smallest of the values that a fraction `level` of them does not exceed."""
    if not len(values):
        return float("nan")
    return float(np.quantile(values, level, method="inverted_cdf"))


class ErrorCurve(eqx.Module):
    """Errors over time.

    Attributes:
        elapsed: mean time since the start of the samples in each interval [T].
        median: of the root-mean-square error of each trajectory in the interval [L].
        high: 90th percentile [L].
        diverged: fraction of the trajectories observed that had diverged.
    """

    elapsed: Float[np.ndarray, " bin"]
    median: Float[np.ndarray, " bin"]
    high: Float[np.ndarray, " bin"]
    diverged: Float[np.ndarray, " bin"]


def error_curve(errors: RolloutErrors, bins: int = BINS) -> ErrorCurve:
    """Quantiles over trajectories in intervals of time; empty ones are left out."""
    edges = np.linspace(0.0, errors.elapsed[errors.scored].max(), bins + 1)
    place = np.clip(np.searchsorted(edges, errors.elapsed, "left") - 1, 0, bins - 1)
    rows = []
    for index in range(bins):
        values = mean_errors(errors, place == index)
        if len(values):
            when = errors.elapsed[errors.scored & (place == index)].mean()
            lost = float(np.mean(np.isinf(values)))
            rows.append((when, quantile(values, MEDIAN), quantile(values, HIGH), lost))
    return ErrorCurve(*np.array(rows).T)


def mean_errors(
    errors: RolloutErrors, chosen: Bool[np.ndarray, "trajectory time"]
) -> Float[np.ndarray, " some"]:
    """Root-mean-square error of each trajectory over its chosen samples [L].

    Trajectories without any are left out.
    """
    scored = errors.scored & chosen
    counts = scored.sum(axis=1)
    squares = np.where(scored, errors.distance, 0.0) ** 2
    return np.sqrt(squares.sum(axis=1)[counts > 0] / counts[counts > 0])


class RolloutSummary(eqx.Module):
    """Errors within an interval of time, over trajectories.

    Attributes:
        median: of the root-mean-square position error of each trajectory [L].
        high: its 90th percentile [L].
        median_relative: median of that error over the way travelled by its end.
        high_relative: its 90th percentile.
        diverged: fraction of trajectories that diverged by its end.
    """

    median: float
    high: float
    median_relative: float
    high_relative: float
    diverged: float
    trajectories: int


def summarise(
    errors: RolloutErrors, after: float = -np.inf, until: float = np.inf
) -> RolloutSummary:
    """Summary of the samples with `after` < time since the start <= `until` [T]."""
    chosen = (errors.elapsed > after) & (errors.elapsed <= until)
    values = mean_errors(errors, chosen)
    scored = errors.scored & chosen
    ways = np.where(scored, errors.path, 0.0).max(axis=1)[scored.any(axis=1)]
    moved = ways > 0
    relative = values[moved] / ways[moved]
    return RolloutSummary(
        median=quantile(values, MEDIAN),
        high=quantile(values, HIGH),
        median_relative=quantile(relative, MEDIAN),
        high_relative=quantile(relative, HIGH),
        diverged=float(np.mean(np.isinf(values))) if len(values) else float("nan"),
        trajectories=len(values),
    )


LENGTHS = (1.0, 5.0, 10.0)
"""Lengths of the rollouts [T]."""

ROLLOUTS = 60
"""Rollouts at most, evenly spread over the data."""


class RestartErrors(eqx.Module):
    """End-point errors: median distance [L] by the length of the rollouts [T]."""

    lengths: Float[np.ndarray, " length"]
    errors: Float[np.ndarray, " length"]
    rollouts: int


def restart_errors(
    dynamics: AbstractDynamics, data: Trajectories
) -> RestartErrors | None:
    """Errors of a first-order model over successive windows; None if none is long."""
    windows = [
        (source, window)
        for source, piece in enumerate(data)
        for window in _windows(piece)
    ]
    if not windows:
        return None
    count = min(len(windows), ROLLOUTS)
    chosen = [windows[i] for i in np.linspace(0, len(windows) - 1, count).astype(int)]
    sources, pieces = zip(*chosen, strict=True)
    parts = Trajectories.from_pieces(pieces, data.channels, data.units, data.provenance)
    paths, _ = predict(dynamics, parts, driven_by=data.select(sources))
    distances = np.full((count, len(LENGTHS)), np.nan)
    for row, (piece, path) in enumerate(zip(pieces, paths, strict=True)):
        ends = np.searchsorted(piece.times, piece.times[0] + np.array(LENGTHS) - 1e-9)
        miss = path[ends] - piece.states[ends]
        distances[row] = np.linalg.norm(miss[:, : data.dim], axis=1)
    return RestartErrors(np.array(LENGTHS), np.median(distances, axis=0), count)


def _windows(piece: Trajectory) -> list[Trajectory]:
    """Parts of the longest length, without the samples that were not observed."""
    seen = np.flatnonzero(piece.observed.all(axis=1))
    times, parts, first = piece.times[seen], [], 0
    while first < len(seen):
        last = int(np.searchsorted(times, times[first] + LENGTHS[-1] - 1e-9))
        if last >= len(seen):
            break
        rows = seen[first : last + 1]
        parts.append(jax.tree.map(lambda array, at=rows: array[at], piece))
        first = last
    return parts
