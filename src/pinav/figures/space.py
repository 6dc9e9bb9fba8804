"""Figures of paths in space: in perspective, and projected along the axes."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from pinav.figures.palette import BLACK, GREY, PAPER, PLAN, WALL
from pinav.figures.style import (
    DIMENSIONLESS,
    SMALL,
    THIN,
    channel_label,
    label_plane,
    new_figure,
    prepare_axes,
    share_legend,
    style_of,
    title_panel,
)
from pinav.navigation.maps import Course

Paths = Mapping[str, Sequence[Float[np.ndarray, "_ 3"]]]
"""Positions of the runs of each controller [L]."""

PROJECTIONS = ((0, 1), (0, 2), (1, 2))
"""Axes of the projections, drawn to the right and upwards."""

ALONG = 24
"""Points along a circle of latitude of a ball in perspective."""


def space_figure(
    course: Course,
    paths: Paths,
    *,
    route: Float[np.ndarray, "_ 3"],
    units: Mapping[str, str] = DIMENSIONLESS,
) -> Figure:
    """Paths in perspective, and their projections along the three axes.

    All panels show the arena whole, lengths along all axes alike.

    Args:
        course: start, goal and obstacles.
        paths: positions of the runs of each controller [L].
        route: the planned way [L].
        units: unit of each channel; "1" means dimensionless.
    """
    figure = new_figure(7.2, 7.4)
    perspective = figure.add_subplot(2, 2, 1, projection="3d")
    _draw_perspective(perspective, course, paths, route, units)
    for panel, axes in enumerate(PROJECTIONS):
        ax = figure.add_subplot(2, 2, panel + 2)
        _draw_projection(ax, course, paths, route, axes, units)
        names = "".join("xyz"[axis] for axis in axes)
        title_panel(ax, f"({'bcd'[panel]}) projection on {names}")
    keys = [Line2D([], [], color=style_of(n).color, lw=1.5, label=n) for n in paths]
    keys.append(Line2D([], [], color=PLAN, lw=1.5, ls="--", label="planned route"))
    share_legend(figure, keys, columns=len(keys))
    return figure


def _draw_perspective(
    ax: Any,
    course: Course,
    paths: Paths,
    route: Float[np.ndarray, "_ 3"],
    units: Mapping[str, str],
) -> None:
    lower, upper = course.arena
    for *center, radius in course.discs:
        ax.plot_surface(*_ball(np.array(center), radius), color=WALL, alpha=0.5)
    for name, runs in paths.items():
        for path in runs:
            ax.plot(*path.T, color=style_of(name).color, lw=THIN, alpha=0.75)
    ax.plot(*route.T, color=PLAN, lw=1.2, ls="--")
    ax.plot(*course.start[:, None], "o", mfc=PAPER, mec=BLACK, ms=5)
    ax.plot(*course.goal[:, None], "x", color=BLACK, ms=6)
    ax.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]))
    ax.set_zlim(lower[2], upper[2])
    ax.set_box_aspect(upper - lower)
    for name in "xyz":
        getattr(ax, f"set_{name}label")(channel_label(name, units))
    ax.tick_params(labelsize=SMALL)
    title_panel(cast(Axes, ax), "(a) in perspective")


def _ball(
    center: Float[np.ndarray, "3"], radius: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A ball's surface on a mesh of longitudes and latitudes."""
    turn, height = np.meshgrid(
        np.linspace(0, 2 * np.pi, ALONG), np.linspace(-np.pi / 2, np.pi / 2, ALONG // 2)
    )
    across = radius * np.cos(height)
    return (
        center[0] + across * np.cos(turn),
        center[1] + across * np.sin(turn),
        center[2] + radius * np.sin(height),
    )


def _draw_projection(
    ax: Axes,
    course: Course,
    paths: Paths,
    route: Float[np.ndarray, "_ 3"],
    axes: tuple[int, int],
    units: Mapping[str, str],
) -> None:
    prepare_axes(ax)
    shown = list(axes)
    for ball in course.discs:
        x, y = ball[shown]
        circle = Circle((float(x), float(y)), float(ball[3]), fc=WALL, ec=BLACK)
        circle.set(alpha=0.5)
        ax.add_patch(circle)
    for name, runs in paths.items():
        for path in runs:
            color = style_of(name).color
            ax.plot(*path[:, shown].T, color=color, lw=THIN, alpha=0.75)
    ax.plot(*route[:, shown].T, color=PLAN, lw=1.2, ls="--")
    x, y = course.goal[shown].tolist()
    goal = Circle((x, y), course.tolerance, fill=False, ec=GREY)
    ax.add_patch(goal)
    ax.plot(*course.start[shown], "o", mfc=PAPER, mec=BLACK, ms=5, zorder=6)
    ax.plot(*course.goal[shown], "x", color=BLACK, ms=5, zorder=6)
    (left, low), (right, high) = course.arena[:, shown]
    ax.set(xlim=(left, right), ylim=(low, high))
    label_plane(ax, units, adjustable="box")
    ax.set_xlabel(channel_label("xyz"[axes[0]], units))
    ax.set_ylabel(channel_label("xyz"[axes[1]], units))
