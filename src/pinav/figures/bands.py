"""Values along one coordinate with their bands, and the truth where it is known."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from pinav.evaluation import normal_interval
from pinav.figures.palette import GREEN, GREY, LEARNED, PURPLE, TRUTH
from pinav.figures.style import (
    WIDE,
    add_legend,
    label_axes,
    prepare_axes,
    with_unit,
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


def profile_band(
    places: Points,
    values: Points,
    sd: Points,
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
    labels = with_unit(coordinate, units[0]), with_unit("force", units[1])
    ax = band(places, values, normal_interval(values, sd), labels=labels, ax=ax)
    ax.axhline(0.0, color=GREY, lw=0.6)
    return ax


def diffusion_bands(
    places: Float[np.ndarray, " point"],
    values: Float[np.ndarray, "point channel"],
    sd: Float[np.ndarray, "point channel"],
    *,
    coordinate: str,
    channels: Sequence[str],
    units: tuple[str, str] = ("1", "1"),
    ax: Axes | None = None,
) -> Axes:
    """Diffusion along each channel over one coordinate, with bands of 95 %.

    Args:
        places: along the coordinate [L].
        values: diffusion along each channel there [L² T⁻¹].
        sd: its standard deviation.
        coordinate: the word for the coordinate.
        channels: names of the columns; those that are equal are drawn once.
        units: of length and time.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    length, time = units
    unit = "" if "1" in units or "?" in length + time else f"{length}²/{time}"
    labels = with_unit(coordinate, length), with_unit("diffusion", unit)
    columns: dict[bytes, list[int]] = {}
    for index, column in enumerate(values.T):
        columns.setdefault(column.tobytes(), []).append(index)
    colors = (LEARNED, GREEN, PURPLE)
    for color, group in zip(colors, columns.values(), strict=False):
        name = ", ".join(channels[index] for index in group)
        first = group[0]
        band(
            places,
            values[:, first],
            normal_interval(values[:, first], sd[:, first]),
            labels=labels,
            color=color,
            name=f"along {name}",
            ax=ax,
        )
    ax.set_ylim(bottom=0.0)
    if len(columns) > 1:
        add_legend(ax)
    return ax
