"""Figures of recordings: rollouts with bands, error by horizon, speed by frequency."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection

from pinav.evaluation import normal_quantile
from pinav.figures.palette import (
    BLACK,
    LEARNED,
    PAPER,
    TRACK,
)
from pinav.figures.style import (
    THIN,
    WIDE,
    add_legend,
    label_axes,
    label_plane,
    prepare_axes,
    style_of,
    with_unit,
)

HALF_WIDTH_90 = normal_quantile(0.9)
"""Of a band of 90 % along one axis, in standard deviations."""


def rollout_paths(
    observed: Sequence[Float[np.ndarray, "_ 2"]],
    predicted: Sequence[Float[np.ndarray, "_ 2"]],
    end_sd: Sequence[Float[np.ndarray, "2"]],
    *,
    units: Mapping[str, str],
    ax: Axes | None = None,
) -> Axes:
    """Observed segments, rollouts from observed starts, and bands at their ends.

    Args:
        observed: positions of each segment [L].
        predicted: positions of each rollout [L].
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
        ax.plot(*path[0], "o", mfc=PAPER, mec=BLACK, markersize=3)
    if len(predicted):
        ends = np.array([path[-1] for path in predicted])
        sizes = 2 * HALF_WIDTH_90 * np.array(end_sd)
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
    label_plane(ax, units)
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
            horizons, values, "o-", color=style.color, lw=THIN, ms=3, label=style.label
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
    half = HALF_WIDTH_90 * sd
    ax.fill_between(
        places, fitted - half, fitted + half, color=LEARNED, alpha=0.25, lw=0
    )
    ax.plot(places, fitted, color=LEARNED, lw=WIDE, label="response, 90 %")
    label_axes(
        ax, with_unit("frequency", "Hz"), with_unit("speed along the command", unit)
    )
    add_legend(ax)
    return ax
