"""Values along one coordinate with their bands, and the truth where it is known."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from pinav.figures.palette import LEARNED, TRUTH
from pinav.figures.style import (
    WIDE,
    label_axes,
    prepare_axes,
)

Points = Float[np.ndarray, " point"]


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
        places: along the coordinate.
        mean: the line.
        interval: lower and upper end of the band, such as `normal_interval` gives.
        truth: drawn below, where it is known.
        color: of line and band.
        name: of the line in a legend.
        line: format of the line, such as "o-".
        width: of the line [pt].
        alpha: opacity of the band.
        labels: of the axes; left alone unless given.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    if truth is not None:
        ax.plot(places, truth, color=TRUTH, lw=WIDE, label="truth")
    ax.fill_between(places, *interval, color=color, alpha=alpha, lw=0)
    ax.plot(places, mean, line, color=color, lw=width, ms=4, label=name)
    if labels is not None:
        label_axes(ax, *labels)
    return ax
