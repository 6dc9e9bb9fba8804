r"""Coverage of the commands of a recording, and speeds over windows.

The drive of an actuated swimmer is $c = f\,(\cos\alpha, \sin\alpha)$ with the frequency
$f$ and the heading $\alpha$; its velocity is about $G\,c(t - \tau) + d$ with a gain
matrix $G$, a delay $\tau$ and a drift $d$.
"""

import dataclasses
from collections.abc import Sequence
from typing import final

import numpy as np
from jaxtyping import Float, Int

from pinav.trajectories import Trajectory

SECTORS = 12
LAG = 0.2
"""Delay whose effect is compared with that of the gains [s]; such rigs have about that.
"""

LEAST_SECTORS, LEAST_SHARE, WORST_CONDITION, MOST_ALIGNED = 3, 0.2, 10.0, 0.9
"""Beyond these, a fit cannot tell apart what `WARNINGS` names."""

WARNINGS = {
    "off": "the drive is off throughout: no gain can be found",
    "frequency": "a single frequency: saturation and step-out cannot be found",
    "heading": "the heading hardly varies: neither the gain matrix nor the heading "
    "offset can be found",
    "axis": "nearly all headings are within 10 degrees of one axis: the gain across it "
    "and the heading offset cannot be told apart",
    "drift": "gain and drift are confounded: vary the heading, or leave the drive off "
    "for a while",
    "delay": "delay and heading offset are confounded, because the turning rate is "
    "nearly constant: fix one of the two",
}


@final
@dataclasses.dataclass(frozen=True)
class Drive:
    r"""Coverage of the commands of one run.

    Attributes:
        frequency: least and greatest frequency [Hz].
        levels: distinct frequencies, rounded to 0.01 Hz.
        off: share of the time at frequency 0.
        sectors: number of the 12 sectors of headings that occurred while driven.
        condition: condition number of the columns $c_x$, $c_y$ and 1, each of unit
            length: the mutual loss of certainty of gains and drift.
        raw_condition: condition number of the unscaled columns.
        aligned: greatest share of the driven time within 10 degrees of one axis.
        delay: share of the change of $c$ within 0.2 s that no other gain matrix and
            drift can produce; where it is small, delay and heading offset are
            confounded.
    """

    frequency: tuple[float, float]
    levels: int
    off: float
    sectors: int
    condition: float
    raw_condition: float
    aligned: float
    delay: float

    def warnings(self) -> list[str]:
        """Limits of a fit to this run, in words."""
        if self.frequency[1] == 0:
            return [WARNINGS["off"]]
        holds = {
            "frequency": self.levels == 1 and self.off == 0,
            "heading": self.sectors < LEAST_SECTORS,
            "axis": self.aligned > MOST_ALIGNED,
            "drift": self.condition > WORST_CONDITION,
            "delay": self.delay < LEAST_SHARE,
        }
        return [WARNINGS[name] for name, true in holds.items() if true]


def drive(segments: Sequence[Trajectory]) -> Drive | None:
    """Coverage of the commands of a run; None where it has no frequency or heading."""
    if not {"frequency", "heading"} <= set(segments[0].commands):
        return None
    frequency = np.concatenate([s.commands["frequency"] for s in segments])
    heading = np.concatenate([s.commands["heading"] for s in segments])
    drives = command_vector(frequency, heading)
    turn = heading[frequency != 0] / (2 * np.pi) % 1.0
    return Drive(
        frequency=(float(frequency.min()), float(frequency.max())),
        levels=len(np.unique(np.round(frequency[frequency != 0], 2))),
        off=float(np.mean(frequency == 0)),
        sectors=len(np.unique((turn * SECTORS).astype(int))),
        condition=_condition(drives, normalised=True),
        raw_condition=_condition(drives, normalised=False),
        aligned=_alignment(heading[frequency != 0]),
        delay=_share_of_delay(segments),
    )


def command_vector(
    frequency: Float[np.ndarray, " time"], heading: Float[np.ndarray, " time"]
) -> Float[np.ndarray, "time 2"]:
    r"""The drive $f\,n(\theta)$ [Hz]."""
    return frequency[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)


def _with_one(drives: Float[np.ndarray, "time 2"]) -> Float[np.ndarray, "time 3"]:
    return np.concatenate([drives, np.ones((len(drives), 1))], axis=1)


def _alignment(headings: Float[np.ndarray, " time"]) -> float:
    """Greatest share of headings within 10 degrees of an axis, either way along it."""
    axes = np.radians(np.arange(0, 180, 5))
    if not len(headings):
        return 0.0
    apart = np.abs(np.sin(headings[:, None] - axes))
    return float((apart <= np.sin(np.radians(10.0))).mean(axis=0).max())


def _condition(drives: Float[np.ndarray, "time 2"], *, normalised: bool) -> float:
    columns = _with_one(drives)
    lengths = np.linalg.norm(columns, axis=0)
    if not (lengths > 0).all():
        return np.inf
    scale = lengths if normalised else np.ones(3)
    values = np.linalg.svd(columns / scale, compute_uv=False)
    return float(values[0] / values[-1]) if values[-1] > 0 else np.inf


def _share_of_delay(segments: Sequence[Trajectory]) -> float:
    """Part of the drive's change within the lag that is not linear in it."""
    now, change = [], []
    for segment in segments:
        times, frequency = segment.times, segment.commands["frequency"]
        drives = command_vector(frequency, segment.commands["heading"])
        known = times - LAG >= times[0]
        before = [np.interp(times[known] - LAG, times, part) for part in drives.T]
        now.append(drives[known])
        change.append(drives[known] - np.stack(before, axis=1))
    columns, changes = _with_one(np.concatenate(now)), np.concatenate(change)
    total = float((changes**2).sum())
    if total == 0:
        return 0.0
    rest = changes - columns @ np.linalg.lstsq(columns, changes)[0]
    return float((rest**2).sum()) / total


WINDOW = 0.5
"""Time over which a displacement counts as a velocity [s]."""

_FEW, _BINS = 60, 12
"""Up to so many distinct frequencies are listed one by one, more in so many bins."""


@final
@dataclasses.dataclass(frozen=True)
class Speed:
    """Speed at a frequency.

    Attributes:
        frequency: commanded frequency, or the middle of its bin [Hz].
        median: median speed [L T⁻¹].
        low: 10 % quantile of the speed [L T⁻¹].
        high: 90 % quantile of the speed [L T⁻¹].
    """

    frequency: float
    median: float
    low: float
    high: float
    windows: int


def pairs_apart(
    times: Float[np.ndarray, " time"], interval: float
) -> tuple[Int[np.ndarray, " pair"], Int[np.ndarray, " pair"]]:
    """Each sample, and the first one that comes an interval or more after it."""
    later = np.searchsorted(times, times + interval)
    first = np.flatnonzero(later < len(times))
    return first, later[first]


def window_ends(segment: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """First and last rows of windows of about `WINDOW`, or of longer intervals."""
    places = np.flatnonzero(segment.observed[:, :2].all(axis=1))
    first, last = pairs_apart(segment.times[places], WINDOW)
    return places[first], places[last]


def window_speeds(segment: Trajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Speed of every window [L T⁻¹], and its first and last row."""
    first, last = window_ends(segment)
    steps = segment.states[last, :2] - segment.states[first, :2]
    lengths = np.linalg.norm(steps, axis=1)
    return lengths / (segment.times[last] - segment.times[first]), first, last


def path_length(segment: Trajectory) -> float:
    """Length of the path in steps of a window, in which errors do not add up [L]."""
    first, last = window_ends(segment)
    rows, at = [0], 0
    following = dict(zip(first.tolist(), last.tolist(), strict=True))
    while at in following:
        at = following[at]
        rows.append(at)
    points = segment.states[rows, :2]
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def speeds_by_frequency(segments: list[Trajectory]) -> list[Speed]:
    """Speed at each frequency, over windows in which the frequency hardly changes."""
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
