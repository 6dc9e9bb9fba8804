"""The look of every figure: colours, labels with units, panels, bands, files' fonts.

Nothing here touches matplotlib's global settings.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, Literal

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pinav.figures.palette import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    HATCH,
    HOTTEST,
    LEARNED,
    ORANGE,
    OUTSIDE,
    PURPLE,
    SKY,
    T10,
    T50,
    T90,
    TRUTH,
    VERMILLION,
)

TEXT, SMALL = 8.0, 7.0
"""Font sizes [pt] of labels and of ticks and legends, for a page 7.5 inches wide."""

WIDE, THIN = 2.4, 1.1
"""Line widths [pt]: truth below, models on top, so that agreement shows as both."""

DIMENSIONLESS: Mapping[str, str] = {}
"""Units of a scenario without any: a channel that is not listed has the unit "1"."""

Points = Float[np.ndarray, " point"]


@dataclasses.dataclass(frozen=True)
class LineStyle:
    """How one model is drawn, in every figure alike.

    Attributes:
        label: what the legend says.
    """

    label: str
    color: str
    dash: str = "-"


STYLES = {
    "truth": LineStyle("truth", BLACK),
    "ude": LineStyle("trained UDE", BLUE),
    "ude-untrained": LineStyle("untrained UDE", VERMILLION, "--"),
    "nn-only": LineStyle("trained NN only", GREEN),
    "nn-only-untrained": LineStyle("untrained NN only", VERMILLION, "--"),
    "physics-only": LineStyle("physics only", GREY, ":"),
    "kernel-potential": LineStyle("kernel potential", ORANGE),
    "kernel-force": LineStyle("kernel force", SKY, "--"),
    "neural-potential": LineStyle("neural potential", PURPLE),
    "neural-force": LineStyle("neural force", VERMILLION, "-."),
    "propulsion": LineStyle("propulsion", ORANGE),
    "environment": LineStyle("environment", BLUE),
    "drag": LineStyle("drag", GREEN),
    "learned": LineStyle("learned model", BLUE),
    "oracle": LineStyle("true model", BLACK),
    "physics only": LineStyle("physics only", GREY),
    "straight line": LineStyle("straight line", ORANGE),
    "line of sight": LineStyle("line of sight", VERMILLION),
    "Gaussian process": LineStyle("Gaussian process", SKY),
    "drift only": LineStyle("drift only", GREY),
    "scalar gain": LineStyle("scalar gain", ORANGE),
    "gain matrix and drift": LineStyle("gain matrix and drift", GREEN),
    "chosen": LineStyle("chosen", BLUE),
    "least squares": LineStyle("least squares", VERMILLION, "--"),
    "hottest cell": LineStyle("hottest cell", HOTTEST),
    "T10": LineStyle("T10", T10),
    "T50": LineStyle("T50", T50),
    "T90": LineStyle("T90", T90),
    "D90 of the tumour": LineStyle("D90 of the tumour", T90),
    "largest outside it": LineStyle("largest outside it", OUTSIDE),
}
"""The look of each model, term, controller and curve of bioheat."""

SPARE = (ORANGE, SKY, GREEN, PURPLE, VERMILLION, BLUE)
"""Colours of what has no entry, in this order."""


def style_of(name: str, index: int = 0) -> LineStyle:
    """Style of a model or term; an unknown name gets the spare colour `index`."""
    return STYLES.get(name) or LineStyle(name, SPARE[index % len(SPARE)])


def pale(color: str) -> tuple[float, float, float]:
    """The colour mixed with white: the second component beside the first."""
    red, green, blue = (1.0 - 0.5 * (1.0 - part) for part in to_rgb(color))
    return red, green, blue


_SYMBOLS = {"vx": "$v_x$", "vy": "$v_y$", "vz": "$v_z$"}


def symbol(channel: str) -> str:
    """A channel as the field writes it: `vx` is a v with subscript x."""
    plain = f"${channel}$" if len(channel) == 1 and channel.isalpha() else channel
    return _SYMBOLS.get(channel, plain)


def with_unit(quantity: str, unit: str) -> str:
    """An axis label; `um` prints as µm, and no unit or one not stated as nothing."""
    if unit in ("1", "") or "?" in unit:
        return quantity
    return f"{quantity} [{unit.replace('um', 'µm')}]"


def channel_label(channel: str, units: Mapping[str, str]) -> str:
    """Axis label of a channel of the data."""
    return with_unit(symbol(channel), units.get(channel, "1"))


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of this size [inch], laid out without overlap."""
    figure = Figure(figsize=(width, height))
    # The default pad cuts titles of the first row by a pixel or two.
    figure.set_layout_engine("constrained", h_pad=0.09, w_pad=0.06)
    return figure


def prepare_axes(ax: Axes | None, *, width: float = 4.0, height: float = 3.2) -> Axes:
    """`ax`, or the axes of a new figure, with fonts and frame set."""
    if ax is None:
        ax = new_figure(width, height).add_subplot()
    ax.tick_params(labelsize=SMALL, length=3.0, width=0.6)
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_linewidth(0.6)
    return ax


LegendPlace = Literal["best", "upper left", "upper right"]


def label_axes(
    ax: Axes,
    x: str,
    y: str,
    *,
    title: str = "",
    legend: int = 0,
    loc: LegendPlace = "best",
) -> Axes:
    """Set both axis labels, the title and a legend of some columns."""
    ax.set_xlabel(x, fontsize=TEXT)
    ax.set_ylabel(y, fontsize=TEXT)
    if title:
        title_panel(ax, title)
    if legend:
        add_legend(ax, columns=legend, loc=loc)
    return ax


def title_panel(ax: Axes, title: str, *, pad: float = 5.0) -> None:
    """Set the title of one panel, flush left, `pad` points above it."""
    ax.set_title(title, fontsize=TEXT, loc="left", pad=pad)


def scale_log(ax: Axes, *groups: Any) -> None:
    """A vertical log scale, if a number is positive: it needs one to begin at."""
    if any((finite(group) > 0).any() for group in groups):
        ax.set_yscale("log")
        ax.tick_params(which="both", labelsize=SMALL)


def mark_line(ax: Axes, *places: float | int) -> None:
    """Vertical dashed lines, such as the end of the training data."""
    for place in places:
        ax.axvline(place, color=GREY, lw=0.8, ls=(0, (4, 2)), zorder=1)


def round_ticks(ax: Axes) -> None:
    """The same few round ticks on both axes of a plane."""
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(nbins=6, steps=[1, 2, 5, 10]))


def label_plane(
    ax: Axes,
    units: Mapping[str, str],
    *,
    adjustable: Literal["box", "datalim"] = "datalim",
    axes: str = "xy",
) -> None:
    """Equal scales, round ticks and the labels of the coordinates."""
    ax.set_aspect("equal", adjustable=adjustable)
    round_ticks(ax)
    label_axes(ax, *(channel_label(name, units) for name in axes))


def add_legend(ax: Axes, *, columns: int = 1, loc: LegendPlace = "best") -> None:
    """Add the legend, on a ground that keeps lines behind it visible, if any.

    Where nothing was drawn, as of tracks none of which could be fitted, there is none.
    """
    if not ax.get_legend_handles_labels()[0]:
        return
    ax.legend(
        fontsize=SMALL,
        ncols=columns,
        loc=loc,
        frameon=True,
        framealpha=0.85,
        edgecolor="none",
        handlelength=1.8,
        columnspacing=1.2,
        borderaxespad=0.3,
    )


def share_legend(
    figure: Figure,
    handles: Sequence[Any],
    *,
    labels: Sequence[str] | None = None,
    columns: int = 2,
) -> None:
    """One legend of artists or bars below all panels, by their own labels or these."""
    names = [str(h.get_label()) for h in handles] if labels is None else labels
    place = {"loc": "outside lower center", "ncols": columns, "fontsize": SMALL}
    figure.legend(handles, names, frameon=False, **place)


def one_legend(
    figure: Figure, axes: Sequence[Axes] | np.ndarray, *, columns: int = 2
) -> None:
    """The longest legend of some panels, once, below all of them."""
    legends = [legend for ax in axes if (legend := ax.get_legend()) is not None]
    if not legends:
        return
    longest = max(legends, key=lambda legend: len(legend.get_texts()))
    handles = [handle for handle in longest.legend_handles if handle is not None]
    labels = [text.get_text() for text in longest.get_texts()]
    for legend in legends:
        legend.remove()
    left = min(ax.get_position().x0 for ax in axes)
    for ax in axes:
        if ax.get_position().x0 > left + 1e-6:
            ax.set_ylabel("")
    share_legend(figure, handles, labels=labels, columns=columns)


def draw_panels(
    size: tuple[float, float],
    panels: Mapping[str, Callable[..., Any]] | Sequence[Callable[..., Any]],
    *,
    columns: int | None = None,
    legend: int = 0,
    sharex: bool = False,
    sharey: bool = False,
) -> Figure:
    """Panels in rows, each with its title, if they have any.

    Args:
        size: width and height of the figure [inch].
        panels: what draws each panel on its argument `ax`, by title.
        columns: panels in a row; all of them unless given.
        legend: columns of one legend for all panels; 0 leaves each panel its own.
        sharex: one horizontal axis for all.
        sharey: one vertical axis for all.
    """
    columns = columns or max(len(panels), 1)
    figure, rows = new_figure(*size), max(-(-len(panels) // columns), 1)
    grid = figure.subplots(rows, columns, sharex=sharex, sharey=sharey, squeeze=False)
    axes = grid.ravel()
    titled = dict(panels) if isinstance(panels, Mapping) else dict(enumerate(panels))
    for ax, (title, draw) in zip(axes, titled.items(), strict=False):
        draw(ax=prepare_axes(ax))
        if isinstance(title, str):
            title_panel(ax, title)
    for ax in axes[len(panels) :]:
        ax.set_visible(False)
    if legend:
        one_legend(figure, axes, columns=legend)
    return figure


def band(
    places: Points,
    mean: Points,
    interval: tuple[Points, Points],
    *,
    truth: Points | None = None,
    color: str = LEARNED,
    name: str | None = None,
    line: str = "-",
    width: float = 1.2,
    alpha: float = 0.25,
    labels: tuple[str, str] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """A line within its band, over the truth.

    Args:
        interval: lower and upper end of the band, such as `normal_interval` gives.
        truth: drawn below, where it is known.
        line: format of the line, such as "o-".
        width: of the line [pt].
        alpha: opacity of the band.
        labels: of the axes; left alone unless given.
    """
    ax = prepare_axes(ax)
    if truth is not None:
        ax.plot(places, truth, color=TRUTH, lw=WIDE, label="truth")
    ax.fill_between(places, *interval, color=color, alpha=alpha, lw=0)
    ax.plot(places, mean, line, color=color, lw=width, ms=4, label=name)
    return ax if labels is None else label_axes(ax, *labels)


def finite(values: np.ndarray | Sequence[float]) -> np.ndarray:
    """The values as float64, NaN where they are not finite, so that lines break."""
    values = np.asarray(values, float)
    return np.where(np.isfinite(values), values, np.nan)


REACH = 1.0
"""A frame shows what leaves the truth by at most this many of its own extents."""


def frame_about(
    truth: np.ndarray, *others: np.ndarray, margin: float = 0.06
) -> np.ndarray:
    """Corners of the view, one per row: all of the truth, and others near it.

    The margin is relative to the larger side of the truth.
    """
    low, high = np.nanmin(truth, axis=0), np.nanmax(truth, axis=0)
    extent = float(np.max(high - low)) or 1.0
    reach = REACH * extent
    corners = [low, high]
    for other in others:
        clipped = np.clip(finite(other), low - reach, high + reach)
        corners += [np.fmin.reduce(clipped), np.fmax.reduce(clipped)]
    pad = margin * extent
    return np.array([np.fmin.reduce(corners) - pad, np.fmax.reduce(corners) + pad])


FILE_SETTINGS: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "pinav",
    "hatch.linewidth": 0.4,
    "hatch.color": HATCH,
    "path.simplify": True,
}
"""Text stays text, and the same figure gives the same bytes."""


def file_settings() -> AbstractContextManager[None]:
    """Context in which figures are written: `FILE_SETTINGS`, then restored."""
    return matplotlib.rc_context(FILE_SETTINGS)
