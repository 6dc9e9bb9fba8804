"""Speeds over windows, which errors of single rows hardly change."""

import dataclasses
from typing import final

import numpy as np

from pinav.trajectories import Trajectory

WINDOW = 0.5
"""Time over which a displacement counts as a velocity [s]."""

_FEW, _BINS = 60, 12
"""Up to so many distinct frequencies are listed one by one, more in so many bins."""


@final
@dataclasses.dataclass(frozen=True)
class Speed:
    """Speed at a frequency.

    Attributes:
        frequency: of the command, or the middle of its bin [Hz].
        median: of the speed [L T⁻¹].
        low: a tenth of the windows are slower.
        high: a tenth are faster.
        windows: how many there are.
    """

    frequency: float
    median: float
    low: float
    high: float
    windows: int


def _window_ends(segment: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """First and last row of every window of about `WINDOW`, lost rows left out.

    Where rows are further apart than that, as with times in frames, a window is a step.
    """
    places = np.flatnonzero(segment.observed[:, :2].all(axis=1))
    times = segment.times[places]
    late = np.searchsorted(times, times + WINDOW)
    late = np.maximum(late, np.arange(len(places)) + 1)
    whole = late < len(places)
    return places[whole], places[late[whole]]


def window_speeds(segment: Trajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Speed of every window [L T⁻¹], and its first and last row.

    Args:
        segment: of a particle.
    """
    first, last = _window_ends(segment)
    steps = segment.states[last, :2] - segment.states[first, :2]
    lengths = np.linalg.norm(steps, axis=1)
    return lengths / (segment.times[last] - segment.times[first]), first, last


def path_length(segment: Trajectory) -> float:
    """Length of the path in steps of a window, in which errors do not add up [L].

    Args:
        segment: of a particle.
    """
    first, last = _window_ends(segment)
    rows, at = [0], 0
    following = dict(zip(first.tolist(), last.tolist(), strict=True))
    while at in following:
        at = following[at]
        rows.append(at)
    points = segment.states[rows, :2]
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def speeds_by_frequency(segments: list[Trajectory]) -> list[Speed]:
    """Speed at each frequency, over windows in which the frequency hardly changes.

    Args:
        segments: of particles under one command.
    """
    logged = np.concatenate([segment.commands["frequency"] for segment in segments])
    levels = np.unique(np.round(logged, 2))
    tolerance = 0.1 if len(levels) > _FEW else 0.0
    frequencies, speeds = [], []
    for segment in segments:
        speed, first, last = window_speeds(segment)
        frequency = np.round(segment.commands["frequency"], 2)
        change = np.abs(frequency[last] - frequency[first])
        steady = change <= tolerance * frequency[first]
        frequencies.append(0.5 * (frequency[first] + frequency[last])[steady])
        speeds.append(speed[steady])
    frequency, speed = np.concatenate(frequencies), np.concatenate(speeds)
    if len(levels) > _FEW and len(frequency):
        levels = np.quantile(frequency, np.arange(_BINS) / _BINS)
    bins = np.searchsorted(levels, frequency, "right")
    return [
        Speed(
            float(np.median(frequency[bins == which])),
            *np.quantile(speed[bins == which], [0.5, 0.1, 0.9]).tolist(),
            windows=int((bins == which).sum()),
        )
        for which in np.unique(bins)
    ]
