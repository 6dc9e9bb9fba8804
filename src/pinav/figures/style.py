"""How every figure looks: colours, labels with their units, axes and files' fonts.

Nothing here touches matplotlib's global settings.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, Literal

import matplotlib
import numpy as np
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
    ORANGE,
    OUTSIDE,
    PURPLE,
    SKY,
    T10,
    T50,
    T90,
    VERMILLION,
)

TEXT, SMALL = 8.0, 7.0
"""Font sizes [pt] of labels and of ticks and legends, for a page 7.5 inches wide."""

WIDE, THIN = 2.4, 1.1
"""Line widths [pt]: truth below, models on top, so that agreement shows as both."""

DIMENSIONLESS: Mapping[str, str] = {}
"""Units of a scenario without any: a channel that is not listed has the unit "1"."""


@dataclasses.dataclass(frozen=True)
class LineStyle:
    """How one model is drawn, in every figure alike.

    Attributes:
        label: what the legend says.
        color: a matplotlib colour.
        dash: a matplotlib line style.
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


def label_axes(ax: Axes, x: str, y: str) -> None:
    """Set both axis labels."""
    ax.set_xlabel(x, fontsize=TEXT)
    ax.set_ylabel(y, fontsize=TEXT)


def title_panel(ax: Axes, title: str, *, pad: float = 5.0) -> None:
    """Set the title of one panel, flush left, `pad` points above it."""
    ax.set_title(title, fontsize=TEXT, loc="left", pad=pad)


def round_ticks(ax: Axes) -> None:
    """The same few round ticks on both axes of a plane."""
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(nbins=6, steps=[1, 2, 5, 10]))


def label_plane(
    ax: Axes,
    units: Mapping[str, str],
    *,
    adjustable: Literal["box", "datalim"] = "datalim",
) -> None:
    """Equal scales, round ticks and the labels of the coordinates x and y."""
    ax.set_aspect("equal", adjustable=adjustable)
    round_ticks(ax)
    label_axes(ax, channel_label("x", units), channel_label("y", units))


LegendPlace = Literal["best", "upper left", "upper right"]


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
    """One legend below all panels.

    Args:
        figure: that holds the panels.
        handles: what is explained: artists, or bars.
        labels: their texts; their own labels unless given.
        columns: in how many columns they stand.
    """
    names = [str(h.get_label()) for h in handles] if labels is None else labels
    place = {"loc": "outside lower center", "ncols": columns, "fontsize": SMALL}
    figure.legend(handles, names, frameon=False, **place)


def finite(values: np.ndarray) -> np.ndarray:
    """The values as float64, NaN where they are not finite, so that lines break."""
    values = np.asarray(values, float)
    return np.where(np.isfinite(values), values, np.nan)


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
