"""Figures of a recording: paths, speeds, clock, commands, and what a model makes."""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pinav.figures.images import Picture
from pinav.figures.palette import (
    BLACK,
    BLUE,
    FILM,
    GREEN,
    GREY,
    LEARNED,
    ORANGE,
    PAPER,
    PURPLE,
    SKY,
    TRACK,
    VERMILLION,
)
from pinav.figures.style import (
    DIMENSIONLESS,
    THIN,
    add_legend,
    band,
    channel_label,
    draw_panels,
    frame_about,
    label_axes,
    label_plane,
    new_figure,
    prepare_axes,
    round_ticks,
    share_legend,
    with_unit,
)
from pinav.recordings import image_positions, labels
from pinav.recordings.drive import command_vector
from pinav.recordings.quality import Quality, positions
from pinav.trajectories import Trajectories


def observed_paths(
    observed: Sequence[Float[np.ndarray, "_ 2"]],
    predicted: Sequence[Float[np.ndarray, "_ 2"]],
    *,
    units: Mapping[str, str] = DIMENSIONLESS,
    ax: Axes | None = None,
) -> Axes:
    """Observed positions as dots, rollouts of the model as lines, starts marked.

    Positions [L] that were not observed are NaN.
    """
    ax = prepare_axes(ax)
    dots = {"color": TRACK, "markersize": 2.0, "label": "observed"}
    line = {"color": LEARNED, "lw": THIN, "label": "model"}
    for measured, path in zip(observed, predicted, strict=True):
        ax.plot(*measured.T, ".", **dots)
        ax.plot(*path.T, **line)
        dots["label"] = line["label"] = "_"
    starts = np.array([path[0] for path in predicted])
    ax.plot(*starts.T, "o", mfc=PAPER, mec=BLACK, markersize=4, label="start")
    (left, low), (right, high) = frame_about(np.concatenate(observed), margin=0.05)
    ax.set(xlim=(left, right), ylim=(low, high))
    label_plane(ax, units, adjustable="box")
    add_legend(ax)
    return ax


def positions_over_time(
    times: Sequence[Float[np.ndarray, " time"]],
    observed: Sequence[Float[np.ndarray, " time"]],
    predicted: Sequence[Float[np.ndarray, " time"]],
    *,
    labels: tuple[str, str],
    ax: Axes | None = None,
) -> Axes:
    """The same of positions on a line, over time."""
    ax = prepare_axes(ax)
    for ts, measured, path in zip(times, observed, predicted, strict=True):
        ax.plot(ts, measured, ".", color=TRACK, markersize=1.5)
        ax.plot(ts, path, color=LEARNED, lw=0.8)
    return label_axes(ax, *labels)


_COLORS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK)
_MARKS = ("o", "s", "^", "D", "v", "P", "X")
"""Runs differ in mark as well as in colour; more runs than these are drawn alike."""

_DOTS = 4000


def recording_figure(recording: Trajectories, quality: Quality) -> Picture:
    """Four panels; those of the commands give way where there are none."""
    second = "(b) median speed over half a second"
    if any(run.speeds for run in quality.runs):
        panels = {"(a) paths": paths, "(b) speed against frequency": speeds}
        panels |= {"(c) intervals between rows": intervals, "(d) commands": commands}
        second += (
            " at each commanded frequency; the band holds 80 % where there is one run"
        )
        last = "(d) commanded frequency and heading."
    else:
        panels = {"(a) paths": paths, "(b) speed of each particle": speeds_of_tracks}
        panels["(c) intervals between rows"] = intervals
        panels["(d) scatter of each particle"] = errors_of_tracks
        last = (
            "(d) scatter of a row from all causes, and what of it is independent from "
            "row to row, the localisation error."
        )
    drawn = {name: partial(draw, recording, quality) for name, draw in panels.items()}

    def draw() -> Figure:
        figure = draw_panels((7.5, 6.6), drawn, columns=2)
        _name_runs(figure, [run.name for run in quality.runs])
        return figure

    caption = (
        "(a) Paths, y up, a mark at each start; segments are not joined; "
        f"{second}; (c) intervals between rows; {last}"
    )
    return Picture("recording", draw, caption, "Four panels", has_many_points=True)


def paths(recording: Trajectories, quality: Quality, ax: Axes) -> Axes:
    """Every segment as a line, its first position as a dot; y up."""
    names = [run.name for run in quality.runs]
    for label, segment in zip(labels(recording), recording, strict=True):
        color, mark = _look(names, str(label["run"]))
        way = positions(segment)
        ax.plot(*way.T, color=color, lw=0.7, alpha=0.8)
        ax.plot(*way[:1].T, mark, ms=2.5, color=color)
    label_plane(ax, recording.units)
    return ax


def overlay_figure(recording: Trajectories, image: np.ndarray) -> Picture:
    """The segments over a still image of the film, in its pixels, y down.

    The image is grey (row, column) or coloured (row, column, channel).

    Raises:
        InputError: the recording was not read from pixels.
    """
    ways = [image_positions(recording, positions(segment)) for segment in recording]

    def draw() -> Figure:
        figure = new_figure(6.0, 5.0)
        ax = prepare_axes(figure.add_subplot())
        ax.imshow(image, cmap=FILM, origin="upper")
        for way in ways:
            ax.plot(*way.T, color=TRACK, lw=1.0)
            ax.plot(*way[:1].T, "o", ms=4, mfc="none", mec=PAPER, mew=1.2)
        label_axes(ax, channel_label("x", {"x": "px"}), channel_label("y", {"y": "px"}))
        return figure

    caption = "Paths over a still of the film, in its pixels; a ring at each start."
    alt = "Paths on the image"
    return Picture("overlay", draw, caption, alt, has_many_points=True)


def speeds(recording: Trajectories, quality: Quality, ax: Axes) -> Axes:
    """Median speed at each frequency, and 80 % of the windows of a single run."""
    names = [run.name for run in quality.runs]
    for run in quality.runs:
        color, mark = _look(names, run.name)
        table = np.array([(s.frequency, s.median, s.low, s.high) for s in run.speeds])
        if not len(table):
            continue
        frequency, middle, low, high = table.T
        alike = len(names) > len(_COLORS)
        line = "-" if alike else f"-{mark}"
        if len(names) == 1:
            drawn = {"color": color, "line": line, "width": 0.8, "alpha": 0.2}
            band(frequency, middle, (low, high), **drawn, ax=ax)
        else:
            ax.plot(frequency, middle, line, color=color, lw=0.8, ms=3)
    ax.set_ylim(bottom=0)
    return label_axes(ax, "frequency [Hz]", _speed_label(recording))


def intervals(recording: Trajectories, quality: Quality, ax: Axes) -> Axes:
    """How often which interval between rows occurs, within segments."""
    steps = np.concatenate([np.diff(segment.times) for segment in recording])
    middle = float(np.median(steps))
    ax.hist(steps, bins=60, range=(0.0, max(2 * middle, steps.max())), color=GREY)
    ax.set_yscale("log")
    ax.set_ylim(bottom=0.5)
    ax.axvline(middle, color=BLACK, lw=0.8, ls="--", label="median")
    interval = with_unit("interval", recording.units["t"])
    return label_axes(ax, interval, "rows", legend=1, loc="upper right")


def commands(recording: Trajectories, quality: Quality, ax: Axes) -> Axes:
    """The drive, as points in the plane: frequency outwards, heading around."""
    names = [run.name for run in quality.runs]
    every = max(1, int(recording.lengths.sum()) // _DOTS)
    for label, segment in zip(labels(recording), recording, strict=True):
        color, mark = _look(names, str(label["run"]))
        logged = segment.commands
        drives = command_vector(logged["frequency"], logged["heading"])[::every]
        ax.plot(*drives.T, mark, ms=1.6, mew=0, color=color, alpha=0.6)
    ax.set_aspect("equal", adjustable="datalim")
    round_ticks(ax)
    return label_axes(ax, "f cos(heading) [Hz]", "f sin(heading) [Hz]")


def speeds_of_tracks(recording: Trajectories, quality: Quality, ax: Axes) -> Axes:
    """Median speed of each particle, in the order of the file."""
    values = [np.nan if t.speed is None else t.speed for t in quality.tracks]
    ax.plot(np.arange(1, len(values) + 1), values, "o", ms=3, color=BLUE)
    ax.set_ylim(bottom=0)
    return _label_particles(ax, _speed_label(recording))


def errors_of_tracks(recording: Trajectories, quality: Quality, ax: Axes) -> Axes:
    """Scatter and localisation error of each particle, the latter with its error."""
    rows = [
        (number, error.scatter, error.deviation, error.error)
        for number, track in enumerate(quality.tracks, start=1)
        if (error := track.localisation) is not None
    ]
    if rows:
        number, scatter, deviation, error = np.array(rows).T
        ax.plot(number, scatter, "x", ms=4, color=GREY, label="from all causes")
        bars = {"fmt": "o", "ms": 3, "color": BLUE, "elinewidth": 0.8}
        ax.errorbar(number, deviation, error, label="independent", **bars)
        add_legend(ax)
    ax.set_ylim(bottom=0)
    return _label_particles(ax, with_unit("deviation", recording.units["x"]))


def _label_particles(ax: Axes, quantity: str) -> Axes:
    """Labels of a quantity over the numbers of the particles."""
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    return label_axes(ax, "particle", quantity)


def _look(names: Sequence[str], name: str) -> tuple[str, str]:
    """Colour and mark of a run."""
    if len(names) > len(_COLORS):
        return BLUE, "o"
    index = list(names).index(name)
    return _COLORS[index], _MARKS[index]


def _name_runs(figure: Figure, names: Sequence[str]) -> None:
    """Runs by mark and colour below the panels, where they are told apart."""
    if not 1 < len(names) <= len(_COLORS):
        return
    handles = []
    for name in names:
        color, mark = _look(names, name)
        short = name if len(name) <= 24 else f"{name[:12]}…{name[-10:]}"
        line = {"color": color, "marker": mark, "lw": 0.8, "ms": 3}
        handles.append(Line2D([], [], label=short, **line))
    share_legend(figure, handles, columns=4)


def _speed_label(recording: Trajectories) -> str:
    return with_unit("speed", f"{recording.units['x']}/{recording.units['t']}")
