"""Figures of recordings: rollouts with bands, error by horizon, speed by frequency."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure

from pinav.evaluation import normal_interval, normal_quantile
from pinav.figures.bands import band
from pinav.figures.images import Picture
from pinav.figures.palette import (
    BLACK,
    LEARNED,
    PAPER,
    TRACK,
)
from pinav.figures.style import (
    SMALL,
    TEXT,
    THIN,
    WIDE,
    add_legend,
    label_axes,
    label_plane,
    new_figure,
    prepare_axes,
    share_legend,
    style_of,
    title_panel,
    with_unit,
)
from pinav.identification import ErrorGrowth, Identification, Paths, SpeedLaw
from pinav.identification.rollouts import HORIZONS, ShownRollout

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
    """Observed paths, rollouts from observed starts, and bands at their ends.

    Args:
        paths: the observed segments, and rollouts of them.
        units: unit of each channel.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    for index, path in enumerate(paths.whole):
        label = "observed" if index == 0 else "_"
        ax.plot(*path.T, color=TRACK, lw=WIDE, label=label)
    for index, one in enumerate(paths.rollouts):
        label = "predicted from ○" if index == 0 else "_"
        ax.plot(*one.predicted.T, color=LEARNED, lw=THIN, label=label)
        ax.plot(*one.predicted[0], "o", mfc=PAPER, mec=BLACK, markersize=4, zorder=4)
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
    ax.add_collection(
        EllipseCollection(
            widths=sizes[:, 0],
            heights=sizes[:, 1],
            angles=np.zeros(len(sizes)),
            units="xy",
            offsets=ends,
            transOffset=ax.transData,
            facecolor=LEARNED,
            edgecolor="none",
            alpha=0.35,
        )
    )
    ax.plot([], [], "o", color=LEARNED, alpha=0.35, label="90 % of each coordinate")


def single_rollouts(
    rollouts: Sequence[ShownRollout], *, units: Mapping[str, str]
) -> Figure:
    """Rollouts one by one, each from its start at the origin, on one scale.

    Args:
        rollouts: the rollouts.
        units: units of length, x, and of time, t.
    """
    figure = new_figure(4.6, 2.1 * -(-len(rollouts) // 3) + 0.7)
    columns = min(3, len(rollouts))
    shape = -(-len(rollouts) // columns), columns
    panels = list(figure.subplots(*shape, sharex=True, sharey=True, squeeze=False).flat)
    for ax, one in zip(panels, rollouts, strict=False):
        seen, path = one.observed, one.predicted
        prepare_axes(ax)
        ax.plot(*(seen - seen[0]).T, color=TRACK, lw=WIDE, label="observed")
        ax.plot(*(path - seen[0]).T, color=LEARNED, lw=THIN, label="predicted from ○")
        _draw_end_bands(ax, (path[-1:] - seen[0]), one.sd[None])
        ax.plot(0, 0, "o", mfc=PAPER, mec=BLACK, markersize=4, zorder=4)
        end = seen[-1] - seen[0]
        ax.plot(*end, "x", color=BLACK, ms=6, mew=1.2, label="observed end", zorder=5)
        title_panel(ax, f"from {one.start:.0f} {units['t']}", pad=2.0)
        ax.set_aspect("equal", adjustable="box")  # shared axes allow no other
        ax.locator_params(nbins=4)
    for ax in panels[len(rollouts) :]:
        ax.set_visible(False)
    low, high = _limits(rollouts)
    panels[0].set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    for ax in panels[::columns]:
        ax.set_ylabel(with_unit("$y$", units["x"]), fontsize=TEXT)
    for ax in panels[max(len(rollouts) - columns, 0) : len(rollouts)]:
        ax.set_xlabel(with_unit("$x$", units["x"]), fontsize=TEXT)
        ax.tick_params(labelbottom=True)
    share_legend(figure, panels[0].get_legend_handles_labels()[0], columns=2)
    return figure


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
    """End-point error of rollouts over their length, with least squares beside it.

    Args:
        growth: the errors.
        units: of positions, x, and of time, t.
        ax: where to draw; a new figure unless given.
    """
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
    label_axes(
        ax,
        with_unit("length of the rollout", units["t"]),
        with_unit("end-point error", units["x"]),
    )
    add_legend(ax)
    return ax


def horizon_errors(
    horizons: Sequence[float],
    relative: Mapping[str, Sequence[float]],
    *,
    time_unit: str = "s",
    ax: Axes | None = None,
) -> Axes:
    """Median end-point error over path length, for each model, over the horizon.

    Args:
        horizons: durations of the rollouts [T].
        relative: errors of each model at these horizons; NaN where there are none.
        time_unit: unit of the horizons.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    for index, (name, values) in enumerate(relative.items()):
        style = style_of(name, index)
        ax.plot(
            horizons,
            values,
            marker="o",
            ls=style.dash,
            color=style.color,
            lw=THIN,
            ms=3,
            label=style.label,
        )
    ax.set(xscale="log", yscale="log")
    ax.set_xticks(list(horizons), [f"{h:g}" for h in horizons])
    ax.minorticks_off()
    label_axes(ax, with_unit("rollout", time_unit), "end-point error / path length")
    add_legend(ax)
    return ax


def speed_law(law: SpeedLaw, *, unit: str = "um/s", ax: Axes | None = None) -> Axes:
    """Speed along the command against frequency, with the fitted response.

    Args:
        law: the observed speeds, and the response.
        unit: of the speed.
        ax: where to draw; a new figure unless given.
    """
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

    def draw() -> Figure:
        figure = new_figure(5.0, 3.4)
        horizon_errors(HORIZONS, errors_by_horizon(result), ax=figure.subplots())
        return figure

    caption = "Error over horizon, medians over tracks."
    alt = "Rollout error over the horizon for each model"
    return Picture("horizons", draw, caption, alt)


def errors_by_horizon(result: Identification) -> dict[str, list[float]]:
    """Relative errors of the lines of the figure, at each horizon."""
    return {
        name: [errors.relative for errors in result.summary[name].errors.values()]
        for name in DRAWN
        if name in result.summary
    }


def rollouts_figure(paths: Paths, name: str, units: Mapping[str, str]) -> Picture:
    """Rollouts one by one."""
    caption = (
        f"Held-out part: {len(paths.rollouts)} rollouts of 10 s, evenly spread over "
        "it, each from an observed position (○) that is put at the origin. × is where "
        "the robot was 10 s later, the ellipse where the model expects 90 % of each "
        "coordinate."
    )
    alt = "Observed and predicted paths, one by one"
    return Picture(
        name, lambda: single_rollouts(paths.rollouts, units=units), caption, alt
    )


def growth_figure(growth: ErrorGrowth, name: str, units: Mapping[str, str]) -> Picture:
    """Errors over the length of rollouts."""

    def draw() -> Figure:
        figure = new_figure(4.2, 3.4)
        error_growth(growth, units=units, ax=figure.subplots())
        return figure

    caption = (
        "Held-out part: end-point error of rollouts over their length, median and the "
        "middle 80 %, with the median of least squares. Dotted: the distance within "
        "which the model's own bands expect 90 % of the ends; it should run along the "
        "upper edge."
    )
    return Picture(name, draw, caption, "End-point error over the length of rollouts")


def speed_figure(law: SpeedLaw, name: str, units: Mapping[str, str]) -> Picture:
    """Speed by frequency."""

    def draw() -> Figure:
        figure = new_figure(4.2, 3.4)
        unit = f"{units['x']}/{units['t']}"
        speed_law(law, unit=unit, ax=figure.subplots())
        return figure

    caption = "Speed along the command over blocks of the whole track, by frequency."
    return Picture(name, draw, caption, "Speed along the command against frequency")


def pixels_figure(paths: Paths, name: str) -> Picture:
    """Rollouts as they lie on the recorded image."""

    def draw() -> Figure:
        figure = new_figure(4.2, 3.6)
        ax = figure.subplots()
        rollout_paths(paths, units={"x": "px", "y": "px"}, ax=ax)
        ax.invert_yaxis()
        return figure

    caption = "The same in the pixels of the image, y down: to lay over a frame."
    return Picture(name, draw, caption, "Paths of a track in image coordinates")
