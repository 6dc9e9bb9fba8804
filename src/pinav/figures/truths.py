"""A learned field with its band, and what is known of it."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from pinav.evaluation import normal_quantile
from pinav.figures.palette import (
    LEARNED,
    TRUTH,
)
from pinav.figures.style import add_legend, label_axes, prepare_axes


def truth_band(
    places: Float[np.ndarray, " place"],
    learned: Float[np.ndarray, " place"],
    sd: Float[np.ndarray, " place"],
    truth: Float[np.ndarray, " place"],
    truth_sd: Float[np.ndarray, " place"],
    *,
    labels: tuple[str, str],
    ax: Axes | None = None,
) -> Axes:
    """A field along one coordinate with its band of 95 %, and its truth.

    Args:
        places: along the coordinate.
        learned: the field there.
        sd: its standard deviation.
        truth: what is known of it; NaN where nothing is.
        truth_sd: standard deviation of that; twice it is drawn.
        labels: of the two axes, with units.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    half = normal_quantile() * sd
    ax.fill_between(
        places, learned - half, learned + half, color=LEARNED, alpha=0.25, lw=0
    )
    ax.plot(places, learned, color=LEARNED, lw=1.2, label="learned, 95 % band")
    low, high = truth - 2 * truth_sd, truth + 2 * truth_sd
    ax.plot(places, truth, color=TRUTH, lw=1.0, ls="--", label="known independently")
    ax.fill_between(places, low, high, color=TRUTH, alpha=0.12, lw=0)
    x, y = (label.replace("um", "µm") for label in labels)
    label_axes(ax, x, y)
    add_legend(ax)
    return ax
