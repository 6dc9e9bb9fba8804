"""Content and quality of a recording, before anything is fitted to it."""

import dataclasses
from typing import Any, final

import numpy as np
from jaxtyping import Float

from pinav.recordings.assembly import groups
from pinav.recordings.conventions import doubts, heading_remark
from pinav.recordings.drive import (
    Drive,
    Speed,
    drive,
    path_length,
    speeds_by_frequency,
    window_speeds,
)
from pinav.recordings.localisation import Localisation, localisation
from pinav.trajectories import UNKNOWN_UNIT, Trajectories, Trajectory


@final
@dataclasses.dataclass(frozen=True)
class Track:
    """One particle of one run; `segments` lie between jumps and gaps.

    Attributes:
        samples: rows with a position.
        lost: rows without a position.
        duration: duration of all segments together [T].
        path: length of the path, in steps of half a second [L].
        speed: median over half a second [L T⁻¹]; None where all are shorter.
        localisation: error and diffusion; None where there are too few samples.
    """

    run: str
    particle: str
    segments: int
    samples: int
    lost: int
    duration: float
    path: float
    speed: float | None
    localisation: Localisation | None


@final
@dataclasses.dataclass(frozen=True)
class Clock:
    """Intervals between rows, within segments; `interval` is their median [T].

    Attributes:
        jitter: half the range of the middle 68 %, over the median.
        gaps: number of intervals longer than 1.5 medians.
    """

    interval: float
    rate: float
    jitter: float
    longest: float
    gaps: int


@final
@dataclasses.dataclass(frozen=True)
class Run:
    """One run: particles under one command, with counts over all of them.

    Attributes:
        duration: from the first time to the last [T].
        scatter: median over particles of the scatter of a row, from all causes [L].
        deviation: median over particles of the localisation error [L].
        drive: coverage of the commands; None where there are none.
        warnings: limits of a fit to this run.
    """

    name: str
    particles: int
    segments: int
    samples: int
    duration: float
    clock: Clock
    scatter: float | None
    deviation: float | None
    drive: Drive | None
    speeds: list[Speed]
    warnings: list[str]


@final
@dataclasses.dataclass(frozen=True)
class Quality:
    """The quality report of a recording.

    Attributes:
        warnings: quantities that no run determines.
        doubts: faults for which a fit refuses the recording.
    """

    source: str
    format: str
    units: dict[str, str]
    runs: list[Run]
    tracks: list[Track]
    notes: list[str]
    warnings: list[str]
    doubts: list[str]
    provenance: dict[str, Any]


def quality(recording: Trajectories) -> Quality:
    """The quality report of a recording, whole or selected.

    Raises:
        InputError: the trajectories are of no recording.
    """
    tracks = [
        _track(str(run), str(particle), [recording.trajectory(i) for i in indices])
        for (run, particle), indices in groups(recording).items()
    ]
    runs = [
        _summarise_run(str(name), [recording.trajectory(i) for i in indices], tracks)
        for (name,), indices in groups(recording, "run").items()
    ]
    provenance = recording.provenance
    return Quality(
        source=str(provenance.get("source", "")),
        format=str(provenance.get("format", "")),
        units=dict(recording.units),
        runs=runs,
        tracks=tracks,
        notes=[*provenance.get("notes", []), *_counts(provenance)],
        warnings=_warnings(recording),
        doubts=doubts(recording),
        provenance={k: v for k, v in provenance.items() if k != "trajectories"},
    )


def _warnings(recording: Trajectories) -> list[str]:
    """Warnings that hold for every run."""
    warnings = []
    if not {"frequency", "heading"} <= set(recording.commands):
        warnings.append(
            "no commands of frequency and heading: a drift and an environment can be "
            "found, a gain cannot"
        )
    if remark := heading_remark(recording):
        warnings.append(remark)
    if recording.units["t"] == "frame":
        warnings.append("times are numbers of frames: give fps to have seconds")
    elif recording.units["t"] == UNKNOWN_UNIT:
        warnings.append("the unit of time is unknown: state it by units, such as t=s")
    if recording.units["x"] == "px":
        warnings.append("positions are in pixels: give mpp to have micrometres")
    elif recording.units["x"] == UNKNOWN_UNIT:
        warnings.append(
            "the unit of length is unknown: state it by units, such as x=um, or give "
            "mpp where it is the pixel"
        )
    return warnings


def _counts(provenance: dict[str, Any]) -> list[str]:
    counts = []
    for key in ("repeated times left out", "rows without a command"):
        if provenance.get(key):
            counts.append(f"{provenance[key]} {key}")
    if bad := provenance.get("bad rows left out"):
        counts.append(f"{len(bad)} bad rows left out, the first: {bad[0]}")
    if left_out := provenance.get("segments left out"):
        counts.append(f"{len(left_out)} segments of a single row left out")
    return counts


def positions(segment: Trajectory) -> Float[np.ndarray, "time 2"]:
    """Positions, NaN where the particle was lost."""
    return np.where(segment.observed[:, :2], segment.states[:, :2], np.nan)


def _track(run: str, particle: str, segments: list[Trajectory]) -> Track:
    paths = [positions(segment) for segment in segments]
    num_observed = int(sum(np.isfinite(path).all(axis=1).sum() for path in paths))
    speeds = np.concatenate([window_speeds(s)[0] for s in segments])
    return Track(
        run=run,
        particle=particle,
        segments=len(segments),
        samples=num_observed,
        lost=int(sum(map(len, paths))) - num_observed,
        duration=float(sum(s.times[-1] - s.times[0] for s in segments)),
        path=float(sum(path_length(segment) for segment in segments)),
        speed=float(np.median(speeds)) if len(speeds) else None,
        localisation=localisation([s.times for s in segments], paths),
    )


def _summarise_run(name: str, segments: list[Trajectory], tracks: list[Track]) -> Run:
    particles = [track for track in tracks if track.run == name]
    known = [t.localisation for t in particles if t.localisation is not None]
    covered = drive(segments)
    ends = [time for segment in segments for time in segment.times[[0, -1]]]
    return Run(
        name=name,
        particles=len(particles),
        segments=len(segments),
        samples=sum(track.samples for track in particles),
        duration=float(max(ends) - min(ends)),
        clock=_clock(segments),
        scatter=_median([one.scatter for one in known]),
        deviation=_median([one.deviation for one in known]),
        drive=covered,
        speeds=[] if covered is None else speeds_by_frequency(segments),
        warnings=[] if covered is None else covered.warnings(),
    )


def _median(values: list[float]) -> float | None:
    return float(np.median(values)) if values else None


def _clock(segments: list[Trajectory]) -> Clock:
    steps = np.concatenate([np.diff(segment.times) for segment in segments])
    low, middle, high = np.quantile(steps, [0.16, 0.5, 0.84]).tolist()
    return Clock(
        interval=middle,
        rate=1.0 / middle,
        jitter=0.5 * (high - low) / middle,
        longest=float(steps.max()),
        gaps=int((steps > 1.5 * middle).sum()),
    )
