"""Profiles of structured terms of a force, with their bands."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from pinav.evaluation import normal_quantile
from pinav.figures.palette import (
    GREY,
    LEARNED,
)
from pinav.figures.style import label_axes, prepare_axes, with_unit


def profile_band(
    places: Float[np.ndarray, " point"],
    values: Float[np.ndarray, " point"],
    sd: Float[np.ndarray, " point"],
    *,
    coordinate: str,
    units: tuple[str, str] = ("1", "1"),
    ax: Axes | None = None,
) -> Axes:
    """The force along one coordinate, with its band of 95 %.

    Args:
        places: along the coordinate [L].
        values: force there [L T⁻²].
        sd: its standard deviation [L T⁻²].
        coordinate: the word for the coordinate.
        units: of length, and of force.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    half = normal_quantile() * sd
    ax.fill_between(
        places, values - half, values + half, color=LEARNED, alpha=0.25, lw=0
    )
    ax.plot(places, values, color=LEARNED, lw=1.2)
    ax.axhline(0.0, color=GREY, lw=0.6)
    label_axes(ax, with_unit(coordinate, units[0]), with_unit("force", units[1]))
    return ax
