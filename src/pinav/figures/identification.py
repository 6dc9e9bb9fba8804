"""Figures of recordings: rollouts with bands, error by horizon, speed by frequency."""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure

from pinav.evaluation import normal_interval, normal_quantile
from pinav.figures.images import Picture
from pinav.figures.palette import BLACK, LEARNED, PAPER, TRACK
from pinav.figures.style import (
    SMALL,
    TEXT,
    THIN,
    WIDE,
    add_legend,
    band,
    draw_panels,
    label_axes,
    label_plane,
    prepare_axes,
    share_legend,
    style_of,
    title_panel,
    with_unit,
)
from pinav.identification import (
    ErrorGrowth,
    Identification,
    IdentifiedTrack,
    Paths,
    SpeedLaw,
)
from pinav.identification.rollouts import HORIZONS, ShownRollout

START = {"mfc": PAPER, "mec": BLACK, "markersize": 4, "zorder": 4}
"""The mark of an observed start."""

DRAWN = (
    "drift only",
    "scalar gain",
    "gain matrix and drift",
    "chosen",
    "least squares",
)
"""Lines of the figure of errors by horizon."""

HALF_WIDTH_90 = normal_quantile(0.9)
"""Of a band of 90 % along one axis, in standard deviations."""


def rollout_paths(
    paths: Paths, *, units: Mapping[str, str], ax: Axes | None = None
) -> Axes:
    """Observed paths, rollouts from observed starts, and bands at their ends."""
    ax = prepare_axes(ax)
    for index, path in enumerate(paths.whole):
        label = "observed" if index == 0 else "_"
        ax.plot(*path.T, color=TRACK, lw=WIDE, label=label)
    for index, one in enumerate(paths.rollouts):
        label = "predicted from ○" if index == 0 else "_"
        ax.plot(*one.predicted.T, color=LEARNED, lw=THIN, label=label)
        ax.plot(*one.predicted[0], "o", **START)
    if paths.rollouts:
        ends = np.array([one.predicted[-1] for one in paths.rollouts])
        _draw_end_bands(ax, ends, np.array([one.sd for one in paths.rollouts]))
        seen = np.array([one.observed[-1] for one in paths.rollouts]).T
        ax.plot(*seen, "x", color=BLACK, ms=5, mew=1.2, label="observed end", zorder=5)
    label_plane(ax, units)
    add_legend(ax)
    return ax


def _draw_end_bands(
    ax: Axes, ends: Float[np.ndarray, "rollout 2"], sd: Float[np.ndarray, "rollout 2"]
) -> None:
    """Ellipses that hold 90 % of each coordinate of the ends."""
    sizes = 2 * HALF_WIDTH_90 * sd
    bands = EllipseCollection(
        sizes[:, 0],
        sizes[:, 1],
        np.zeros(len(sizes)),
        units="xy",
        offsets=ends,
        transOffset=ax.transData,
        facecolor=LEARNED,
        edgecolor="none",
        alpha=0.35,
    )
    ax.add_collection(bands)
    ax.plot([], [], "o", color=LEARNED, alpha=0.35, label="90 % of each coordinate")


def single_rollouts(
    rollouts: Sequence[ShownRollout], *, units: Mapping[str, str]
) -> Figure:
    """Rollouts one by one, each from its start at the origin, on one scale."""
    columns = min(3, len(rollouts))
    panels = [partial(_single_rollout, one, units["t"]) for one in rollouts]
    size = 4.6, 2.1 * -(-len(rollouts) // 3) + 0.7
    figure = draw_panels(size, panels, columns=columns, sharex=True, sharey=True)
    axes = figure.axes[: len(rollouts)]
    low, high = _limits(rollouts)
    axes[0].set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    for ax in axes[::columns]:
        ax.set_ylabel(with_unit("$y$", units["x"]), fontsize=TEXT)
    for ax in axes[max(len(rollouts) - columns, 0) :]:
        ax.set_xlabel(with_unit("$x$", units["x"]), fontsize=TEXT)
        ax.tick_params(labelbottom=True)
    share_legend(figure, axes[0].get_legend_handles_labels()[0], columns=2)
    return figure


def _single_rollout(one: ShownRollout, time: str, *, ax: Axes) -> None:
    origin = one.observed[0]
    seen, path = one.observed - origin, one.predicted - origin
    ax.plot(*seen.T, color=TRACK, lw=WIDE, label="observed")
    ax.plot(*path.T, color=LEARNED, lw=THIN, label="predicted from ○")
    _draw_end_bands(ax, path[-1:], one.sd[None])
    ax.plot(0, 0, "o", **START)
    ax.plot(*seen[-1], "x", color=BLACK, ms=6, mew=1.2, label="observed end", zorder=5)
    title_panel(ax, f"from {one.start:.0f} {time}", pad=2.0)
    ax.set_aspect("equal", adjustable="box")  # shared axes allow no other
    ax.locator_params(nbins=4)


def _limits(
    rollouts: Sequence[ShownRollout],
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """A frame that holds all paths from the origin, with the bands at their ends."""
    points = []
    for one in rollouts:
        seen, path, reach = one.observed, one.predicted, HALF_WIDTH_90 * one.sd
        points += [seen, path, path[-1:] - reach, path[-1:] + reach]
        points[-4:] = [part - seen[0] for part in points[-4:]]
    every = np.concatenate(points)
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.05 * (high - low)
    return low - margin, high + margin


def error_growth(
    growth: ErrorGrowth, *, units: Mapping[str, str], ax: Axes | None = None
) -> Axes:
    """End-point error of rollouts over their length, with least squares beside it."""
    ax = prepare_axes(ax)
    lengths, (low, middle, high) = growth.lengths, growth.errors
    ax.plot([], [], color=LEARNED, alpha=0.25, lw=6, label="10 to 90 % of rollouts")
    marked = {"line": "o-", "width": WIDE, "name": "chosen model"}
    band(lengths, middle, (low, high), **marked, ax=ax)
    ax.plot(lengths, growth.reference, "s--", color=TRACK, lw=THIN, ms=3)
    ax.lines[-1].set_label("least squares")
    ax.plot(lengths, growth.promised, ":", color=BLACK, lw=WIDE)
    ax.lines[-1].set_label("band of the model, 90 %")
    ax.set(xscale="log", yscale="log")
    ticks = [value for value in (0.5, 1.0, 2.0, 5.0, 10.0, 30.0) if value in lengths]
    ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.xaxis.minorticks_off()
    ax.tick_params(which="minor", labelsize=SMALL)
    length = with_unit("length of the rollout", units["t"])
    return label_axes(ax, length, with_unit("end-point error", units["x"]), legend=1)


def horizon_errors(
    horizons: Sequence[float],
    relative: Mapping[str, Sequence[float]],
    *,
    ax: Axes | None = None,
) -> Axes:
    """Median end-point error over path length, for each model, over the horizon.

    Args:
        horizons: durations of the rollouts [s].
        relative: errors of each model at these horizons; NaN where there are none.
    """
    ax = prepare_axes(ax)
    for index, (name, values) in enumerate(relative.items()):
        style = style_of(name, index)
        line = {"color": style.color, "ls": style.dash, "lw": THIN}
        ax.plot(horizons, values, marker="o", ms=3, label=style.label, **line)
    ax.set(xscale="log", yscale="log")
    ax.set_xticks(list(horizons), [f"{h:g}" for h in horizons])
    ax.minorticks_off()
    return label_axes(ax, "rollout [s]", "end-point error / path length", legend=1)


def speed_law(law: SpeedLaw, *, unit: str = "um/s", ax: Axes | None = None) -> Axes:
    """Speed along the command against frequency, with the fitted response."""
    ax = prepare_axes(ax)
    dots = {"color": TRACK, "markersize": 2.5, "label": "observed, blocks"}
    ax.plot(law.frequency, law.speed, ".", **dots)
    labels = with_unit("frequency", "Hz"), with_unit("speed along the command", unit)
    shown = {"width": WIDE, "name": "response, 90 %", "labels": labels}
    ends = normal_interval(law.fitted, law.sd, 0.9)
    band(law.places, law.fitted, ends, **shown, ax=ax)
    add_legend(ax)
    return ax


def horizons_figure(result: Identification) -> Picture:
    """Errors by the length of rollouts, medians over tracks."""
    draw = partial(horizon_errors, HORIZONS, errors_by_horizon(result))
    return Picture(
        "horizons",
        partial(draw_panels, (5.0, 3.4), [draw]),
        "Error over horizon, medians over tracks.",
        "Rollout error over the horizon for each model",
    )


def errors_by_horizon(result: Identification) -> dict[str, list[float]]:
    """Relative errors of the lines of the figure, at each horizon."""
    return {
        name: [errors.relative for errors in result.summary[name].errors.values()]
        for name in DRAWN
        if name in result.summary
    }


def track_figures(
    index: int, track: IdentifiedTrack, units: Mapping[str, str]
) -> list[Picture]:
    """Rollouts one by one, their errors by length, the speed law, and the image."""
    pictures = []
    if track.paths is not None and track.paths.rollouts:
        pictures.append(
            Picture(
                f"track-{index}",
                partial(single_rollouts, track.paths.rollouts, units=units),
                f"Held-out part: {len(track.paths.rollouts)} rollouts of 10 s, evenly "
                "spread over it, each from an observed position (○) that is put at the "
                "origin. × is where the robot was 10 s later, the ellipse where the "
                "model expects 90 % of each coordinate.",
                "Observed and predicted paths, one by one",
            )
        )
    if track.growth is not None and len(track.growth.lengths) > 1:
        draw = partial(error_growth, track.growth, units=units)
        pictures.append(
            Picture(
                f"growth-{index}",
                partial(draw_panels, (4.2, 3.4), [draw]),
                "Held-out part: end-point error of rollouts over their length, median "
                "and the middle 80 %, with the median of least squares. Dotted: the "
                "distance within which the model's own bands expect 90 % of the ends; "
                "it should run along the upper edge.",
                "End-point error over the length of rollouts",
            )
        )
    if track.law is not None:
        draw = partial(speed_law, track.law, unit=f"{units['x']}/{units['t']}")
        pictures.append(
            Picture(
                f"speed-{index}",
                partial(draw_panels, (4.2, 3.4), [draw]),
                "Speed along the command over blocks of the whole track, by frequency.",
                "Speed along the command against frequency",
            )
        )
    if track.image_paths is not None:
        pictures.append(
            Picture(
                f"image-{index}",
                partial(draw_panels, (4.2, 3.6), [partial(_image, track.image_paths)]),
                "The same in the pixels of the image, y down: to lay over a frame.",
                "Paths of a track in image coordinates",
            )
        )
    return pictures


def _image(paths: Paths, *, ax: Axes) -> None:
    rollout_paths(paths, units={"x": "px", "y": "px"}, ax=ax).invert_yaxis()
