"""Figures of a design of experiments."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogLocator

from pinav.figures.navigation import spread_map
from pinav.figures.palette import BLACK, GREY, NEXT, PURPLE, TRACK
from pinav.figures.style import (
    DIMENSIONLESS,
    add_legend,
    label_axes,
    new_figure,
    prepare_axes,
)
from pinav.navigation.maps import Course, ForceMaps

LOOKS: Mapping[str, tuple[str, str]] = {
    "informed": (NEXT, "-"),
    "random": (GREY, "--"),
    "grid": (PURPLE, "-."),
}
"""Colour and dash of each design."""


def bounds_figure(
    bounds: Mapping[str, Sequence[Float[np.ndarray, " count"]]], accuracy: float
) -> Figure:
    """How well the force along the way is known after each trajectory.

    Args:
        bounds: of each design, one curve a campaign.
        accuracy: what was asked for.
    """
    figure = new_figure(5.2, 3.2)
    ax = prepare_axes(figure.add_subplot())
    for name, curves in bounds.items():
        color, dash = LOOKS[name]
        for index, curve in enumerate(curves):
            label = name if index == 0 else None
            ax.plot(100 * curve, color=color, ls=dash, lw=1.2, label=label)
    ax.axhline(100 * accuracy, color=BLACK, lw=0.8, ls=":", label="asked for")
    ax.set_yscale("log")
    ax.set_ylim(top=110)
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter("")
    label_axes(ax, "trajectories", "bound of the error [%]")
    add_legend(ax)
    return figure


def recordings_figure(
    course: Course,
    maps: ForceMaps,
    paths: Sequence[Float[np.ndarray, "_ 2"]],
    *,
    way: Float[np.ndarray, "_ 2"],
    thrust: float,
    units: Mapping[str, str] = DIMENSIONLESS,
) -> Figure:
    """What was recorded, over what is not known of the force, and the planned way.

    Args:
        course: start, goal and obstacles.
        maps: the learned force, and its standard deviation.
        paths: positions of the trajectories [L].
        way: the planned way [L].
        thrust: greatest thrust of the swimmer [L T⁻²].
        units: unit of each channel.
    """
    figure = new_figure(4.8, 4.8)
    ax = figure.add_subplot()
    assert maps.sd is not None
    spread_map(
        maps.learned,
        maps.sd,
        course,
        thrust=thrust,
        route=way,
        units=units,
        ax=ax,
    )
    halo = [withStroke(linewidth=2.0, foreground=BLACK)]
    for index, path in enumerate(paths):
        label = "recorded" if index == 0 else None
        ax.plot(*path.T, color=TRACK, lw=0.9, path_effects=halo, label=label)
    add_legend(ax)
    return figure
