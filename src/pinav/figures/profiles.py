"""Values along one coordinate with their bands: forces, diffusion, a reference."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from pinav.evaluation import normal_quantile
from pinav.figures.palette import (
    GREEN,
    GREY,
    LEARNED,
    PURPLE,
    TRACK,
)
from pinav.figures.style import add_legend, label_axes, prepare_axes, with_unit


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
    labels = with_unit(coordinate, units[0]), with_unit("force", units[1])
    ax = value_band(places, values, sd, labels=labels, ax=ax)
    ax.axhline(0.0, color=GREY, lw=0.6)
    return ax


def value_band(
    places: Float[np.ndarray, " point"],
    values: Float[np.ndarray, " point"],
    sd: Float[np.ndarray, " point"],
    *,
    labels: tuple[str, str],
    color: str = LEARNED,
    name: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Values along one coordinate, with their band of 95 %.

    Args:
        places: along the coordinate.
        values: there.
        sd: their standard deviation.
        labels: of the axes.
        color: of line and band.
        name: of the line in a legend.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    half = normal_quantile() * sd
    ax.fill_between(places, values - half, values + half, color=color, alpha=0.25, lw=0)
    ax.plot(places, values, color=color, lw=1.2, label=name)
    label_axes(ax, *labels)
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
        value_band(
            places,
            values[:, first],
            sd[:, first],
            labels=labels,
            color=color,
            name=f"along {name}",
            ax=ax,
        )
    ax.set_ylim(bottom=0.0)
    if len(columns) > 1:
        add_legend(ax)
    return ax


def positions_over_time(
    times: Sequence[Float[np.ndarray, " time"]],
    observed: Sequence[Float[np.ndarray, " time"]],
    predicted: Sequence[Float[np.ndarray, " time"]],
    *,
    labels: tuple[str, str],
    ax: Axes | None = None,
) -> Axes:
    """Observed positions on a line as dots, rollouts of the model as lines.

    Args:
        times: of each trajectory [T].
        observed: positions [L]; NaN where not observed.
        predicted: positions of its rollout [L].
        labels: of the axes.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    for ts, measured, path in zip(times, observed, predicted, strict=True):
        ax.plot(ts, measured, ".", color=TRACK, markersize=1.5)
        ax.plot(ts, path, color=LEARNED, lw=0.8)
    label_axes(ax, *labels)
    return ax
