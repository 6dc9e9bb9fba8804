"""The figure of how the error of each recipe falls with time."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from benchmarks.fit.contestants import BY_NAME
from pinav.figures.palette import (
    BLUE,
    GREEN,
    GREY,
    VERMILLION,
)
from pinav.figures.style import SMALL, add_legend, label_axes, new_figure, prepare_axes

PAPER_RMSE = 0.015
"""Where the paper's own fit ends (its Table 2)."""

_STYLES = {
    "paper-recipe": (VERMILLION, "-", ""),
    "ude": (BLUE, "-", "o"),
    "ude-kernel": (GREEN, "--", "s"),
}


def figure(curves: Mapping[str, np.ndarray]) -> Figure:
    """The panel as a figure of its own."""
    drawn = new_figure(5.2, 3.4)
    convergence(curves, ax=drawn.add_subplot())
    return drawn


def convergence(curves: Mapping[str, np.ndarray], *, ax: Axes | None = None) -> Axes:
    """Error over wall time, both on logarithmic axes.

    Args:
        curves: seconds since the process began, and RMSE as the fit itself sees it,
            by name of the contestant.
        ax: where to draw; new axes unless given.
    """
    ax = prepare_axes(ax)
    for name, curve in curves.items():
        color, dash, marker = _STYLES.get(name, (GREY, ":", ""))
        ax.plot(
            curve[:, 0],
            curve[:, 1],
            color=color,
            linestyle=dash,
            marker=marker,
            markersize=3.5,
            linewidth=1.3,
            label=BY_NAME[name].label,
        )
    ax.axhline(PAPER_RMSE, color=GREY, linestyle=":", linewidth=1.0)
    ax.annotate(
        f"the paper's fit, {PAPER_RMSE}",
        (0.02, PAPER_RMSE),
        xycoords=("axes fraction", "data"),
        xytext=(0, 2),
        textcoords="offset points",
        fontsize=SMALL,
        color=GREY,
    )
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.tick_params(which="both", labelsize=SMALL)
    for subset in (ax.xaxis.set_major_formatter, ax.xaxis.set_minor_formatter):
        subset(LogFormatter(minor_thresholds=(2.0, 0.5)))
    label_axes(ax, "wall time of the cold process [s]", "total RMSE")
    add_legend(ax)
    return ax
