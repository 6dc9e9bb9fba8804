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
    channel_label,
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
from pinav.identification.rollouts import HORIZONS

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
    observed: Sequence[Float[np.ndarray, "_ 2"]],
    predicted: Sequence[Float[np.ndarray, "_ 2"]],
    seen_ends: Sequence[Float[np.ndarray, "2"]],
    end_sd: Sequence[Float[np.ndarray, "2"]],
    *,
    units: Mapping[str, str],
    ax: Axes | None = None,
) -> Axes:
    """Observed paths, rollouts from observed starts, and bands at their ends.

    Args:
        observed: positions of each segment [L].
        predicted: positions of each rollout [L].
        seen_ends: where each rollout was observed to end [L].
        end_sd: standard deviation of each rollout's end along x and y [L].
        units: unit of each channel.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    for index, path in enumerate(observed):
        label = "observed" if index == 0 else "_"
        ax.plot(*path.T, color=TRACK, lw=WIDE, label=label)
    for index, path in enumerate(predicted):
        label = "predicted from ○" if index == 0 else "_"
        ax.plot(*path.T, color=LEARNED, lw=THIN, label=label)
        ax.plot(*path[0], "o", mfc=PAPER, mec=BLACK, markersize=4, zorder=4)
    if len(predicted):
        ends = np.array([path[-1] for path in predicted])
        _draw_end_bands(ax, ends, np.array(end_sd))
        seen = np.array(seen_ends).T
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
    rollouts: Sequence[
        tuple[
            Float[np.ndarray, "_ 2"], Float[np.ndarray, "_ 2"], Float[np.ndarray, "2"]
        ]
    ],
    titles: Sequence[str],
    *,
    units: Mapping[str, str],
    figure: Figure,
) -> list[Axes]:
    """Rollouts one by one, each from its start at the origin, on one scale.

    Args:
        rollouts: observed path, predicted path, and the standard deviation of the
            predicted end along x and y, of each [L].
        titles: of the panels.
        units: unit of each channel.
        figure: where to draw.
    """
    columns = min(3, len(rollouts))
    shape = -(-len(rollouts) // columns), columns
    panels = list(figure.subplots(*shape, sharex=True, sharey=True, squeeze=False).flat)
    for ax, (seen, path, sd), title in zip(panels, rollouts, titles, strict=False):
        prepare_axes(ax)
        ax.plot(*(seen - seen[0]).T, color=TRACK, lw=WIDE, label="observed")
        ax.plot(*(path - seen[0]).T, color=LEARNED, lw=THIN, label="predicted from ○")
        _draw_end_bands(ax, (path[-1:] - seen[0]), sd[None])
        ax.plot(0, 0, "o", mfc=PAPER, mec=BLACK, markersize=4, zorder=4)
        end = seen[-1] - seen[0]
        ax.plot(*end, "x", color=BLACK, ms=6, mew=1.2, label="observed end", zorder=5)
        title_panel(ax, title, pad=2.0)
        ax.set_aspect("equal", adjustable="box")  # shared axes allow no other
        ax.locator_params(nbins=4)
    for ax in panels[len(rollouts) :]:
        ax.set_visible(False)
    low, high = _limits(rollouts)
    panels[0].set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    for ax in panels[::columns]:
        ax.set_ylabel(channel_label("y", units), fontsize=TEXT)
    for ax in panels[max(len(rollouts) - columns, 0) : len(rollouts)]:
        ax.set_xlabel(channel_label("x", units), fontsize=TEXT)
        ax.tick_params(labelbottom=True)
    share_legend(figure, panels[0].get_legend_handles_labels()[0], columns=2)
    return panels[: len(rollouts)]


def _limits(
    rollouts: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """What holds all paths from the origin, with the bands at their ends."""
    points = []
    for seen, path, sd in rollouts:
        reach = HALF_WIDTH_90 * sd
        points += [seen, path, path[-1:] - reach, path[-1:] + reach]
        points[-4:] = [part - seen[0] for part in points[-4:]]
    every = np.concatenate(points)
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.05 * (high - low)
    return low - margin, high + margin


def error_growth(
    lengths: Float[np.ndarray, " length"],
    errors: Float[np.ndarray, "3 length"],
    reference: Float[np.ndarray, " length"],
    promised: Float[np.ndarray, " length"],
    *,
    units: Mapping[str, str],
    ax: Axes | None = None,
) -> Axes:
    """End-point error of rollouts over their length, with least squares beside it.

    Args:
        lengths: of the rollouts [T].
        errors: 10 % quantile, median and 90 % quantile over rollouts [L].
        reference: median error of least squares [L].
        promised: distance within which the bands expect 90 % of the ends [L].
        units: of positions, x, and of time, t.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    low, middle, high = errors
    ax.plot([], [], color=LEARNED, alpha=0.25, lw=6, label="10 to 90 % of rollouts")
    marked = {"line": "o-", "width": WIDE, "name": "chosen model"}
    band(lengths, middle, (low, high), **marked, ax=ax)
    ax.plot(lengths, reference, "s--", color=TRACK, lw=THIN, ms=3)
    ax.lines[-1].set_label("least squares")
    ax.plot(lengths, promised, ":", color=BLACK, lw=WIDE)
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


def speed_law(
    frequency: Float[np.ndarray, " point"],
    speed: Float[np.ndarray, " point"],
    curve: tuple[
        Float[np.ndarray, " place"],
        Float[np.ndarray, " place"],
        Float[np.ndarray, " place"],
    ],
    *,
    unit: str = "um/s",
    ax: Axes | None = None,
) -> Axes:
    """Speed along the command against frequency, with the fitted response.

    Args:
        frequency: commanded, one for each block [Hz].
        speed: observed along the turned heading [L T⁻¹].
        curve: frequencies, fitted speeds and their standard deviations.
        unit: of the speed.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    places, fitted, sd = curve
    ax.plot(
        frequency, speed, ".", color=TRACK, markersize=2.5, label="observed, blocks"
    )
    labels = with_unit("frequency", "Hz"), with_unit("speed along the command", unit)
    shown = {"width": WIDE, "name": "response, 90 %", "labels": labels}
    band(places, fitted, normal_interval(fitted, sd, 0.9), **shown, ax=ax)
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

    def draw() -> Figure:
        figure = new_figure(4.6, 2.1 * -(-len(paths.rollouts) // 3) + 0.7)
        titles = [f"from {one.start:.0f} {units['t']}" for one in paths.rollouts]
        panels = [(one.observed, one.predicted, one.sd) for one in paths.rollouts]
        plane = {"x": units["x"], "y": units["x"]}
        single_rollouts(panels, titles, units=plane, figure=figure)
        return figure

    caption = (
        f"Held-out part: {len(paths.rollouts)} rollouts of 10 s, evenly spread over "
        "it, each from an observed position (○) that is put at the origin. × is where "
        "the robot was 10 s later, the ellipse where the model expects 90 % of each "
        "coordinate."
    )
    return Picture(name, draw, caption, "Observed and predicted paths, one by one")


def growth_figure(growth: ErrorGrowth, name: str, units: Mapping[str, str]) -> Picture:
    """Errors over the length of rollouts."""

    def draw() -> Figure:
        figure = new_figure(4.2, 3.4)
        curves = growth.lengths, growth.errors, growth.reference, growth.promised
        error_growth(*curves, units=units, ax=figure.subplots())
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
        curve = law.places, law.fitted, law.sd
        speed_law(law.frequency, law.speed, curve, unit=unit, ax=figure.subplots())
        return figure

    caption = "Speed along the command over blocks of the whole track, by frequency."
    return Picture(name, draw, caption, "Speed along the command against frequency")


def overlay_figure(paths: Paths, name: str) -> Picture:
    """Rollouts as they lie on the recorded image."""

    def draw() -> Figure:
        figure = new_figure(4.2, 3.6)
        ax = figure.subplots()
        rollout_paths(
            paths.whole,
            [one.predicted for one in paths.rollouts],
            [one.observed[-1] for one in paths.rollouts],
            [one.sd for one in paths.rollouts],
            units={"x": "px", "y": "px"},
            ax=ax,
        )
        ax.invert_yaxis()
        return figure

    caption = "The same in the pixels of the image, y down: to lay over a frame."
    return Picture(name, draw, caption, "Paths of a track in image coordinates")
