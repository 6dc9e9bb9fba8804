"""Figures of navigation and of designs: plans, routes over the force, outcomes."""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any, cast

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogLocator, MaxNLocator

from pinav.evaluation import FieldMap
from pinav.figures.maps import DEVIATION, Look, draw_arrows, map_panel
from pinav.figures.palette import (
    BEYOND,
    BLACK,
    GRADED,
    GREY,
    NEXT,
    PAPER,
    PLAIN,
    PLAN,
    PURPLE,
    TRACK,
    WALL,
)
from pinav.figures.style import (
    DIMENSIONLESS,
    SMALL,
    THIN,
    WIDE,
    add_legend,
    channel_label,
    draw_panels,
    file_settings,
    label_axes,
    label_plane,
    new_figure,
    prepare_axes,
    share_legend,
    style_of,
    title_panel,
    with_unit,
)
from pinav.learning.findings import ForceMaps
from pinav.navigation import Navigation
from pinav.navigation.design.campaign import DesignResult
from pinav.navigation.task.task import Course
from pinav.navigation.trials.metrics import Interval


def draw_course(ax: Axes, course: Course) -> None:
    """Draw start, goal, obstacles and arena over a map."""
    (x0, y0), (x1, y1) = course.arena
    frame = Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, ec=GREY, lw=0.8)
    ax.add_patch(frame)
    for x, y, radius in course.discs:
        ax.add_patch(Circle((x, y), radius, fc=WALL, ec=BLACK, lw=0.8))
    x, y = course.goal.tolist()
    ring = {"fill": False, "ec": BLACK, "lw": 1.2, "zorder": 5}
    ax.add_patch(Circle((x, y), course.tolerance, **ring))
    ax.plot(x, y, "x", color=BLACK, ms=5, zorder=6, path_effects=_halo(PAPER, 2.5))
    ax.plot(*course.start, "o", mfc=PAPER, mec=BLACK, ms=5, zorder=6)
    margin = 0.02 * float(max(x1 - x0, y1 - y0))
    ax.set(xlim=(x0 - margin, x1 + margin), ylim=(y0 - margin, y1 + margin))


def plan_map(
    time: Float[np.ndarray, "x y"],
    course: Course,
    *,
    route: Float[np.ndarray, "_ 2"] | None = None,
    units: Mapping[str, str] = DIMENSIONLESS,
    ax: Axes | None = None,
) -> Axes:
    """Time-to-go from rest in colour, with contours; hatched where there is no way.

    Args:
        time: time-to-go at equally spaced points of the arena [T]; infinite where the
            goal cannot be reached.
        route: the planned way [L].
    """
    x, y = map(np.linspace, *course.arena, time.shape)
    values, nothing = time.T, np.zeros((y.size, x.size))
    grid = FieldMap(x, y, np.stack([nothing, nothing], axis=-1), nothing)
    known = values[np.isfinite(values)]
    top = float(np.quantile(known, 0.98)) if known.size else 1.0
    label = with_unit("time to go from rest", units.get("t", "1"))
    look = Look(f"{GRADED}_r", label, lengths=None, contours=9)
    shown = {"limits": (0.0, top), "shade": None, "units": units}
    ax = map_panel(grid, values, look, **shown, ax=ax)
    closed = ~np.isfinite(values)
    if closed.any():
        ground = x, y, closed.astype(float), [0.5, 1.5]
        with file_settings():
            ax.contourf(*ground, colors=[BEYOND], alpha=0.9)
            ax.contourf(*ground, colors="none", hatches=["///"])
    if route is not None:
        ax.plot(*route.T, color=BLACK, lw=1.2, path_effects=_halo(PAPER, 2.6), zorder=4)
    draw_course(ax, course)
    return ax


def _halo(color: str, width: float) -> list[withStroke]:
    """A ground that keeps a line visible on any map."""
    return [withStroke(linewidth=width, foreground=color)]


def paths_map(
    field: FieldMap,
    course: Course,
    paths: Mapping[str, Sequence[Float[np.ndarray, "_ 2"]]],
    *,
    limit: float,
    units: Mapping[str, str] = DIMENSIONLESS,
    ax: Axes | None = None,
) -> Axes:
    """Closed-loop paths [L] of controllers over a force.

    `limit` is the top of the colour scale [L T⁻²].
    """
    size = np.linalg.norm(field.force, axis=-1)
    shown = {"limits": (0.0, 1.6 * limit), "shade": None, "units": units}
    ax = map_panel(field, size, Look(PLAIN, "$|F|$"), **shown, ax=ax)
    draw_arrows(ax, field.x, field.y, field.force, limit)
    for name, runs in paths.items():
        first = name == "oracle"
        width, order = (WIDE, 2.1) if first else (THIN, 2.2)
        for path in runs:
            (line,) = ax.plot(*path.T, color=style_of(name).color, alpha=0.75)
            line.set(linewidth=width, zorder=order)
    draw_course(ax, course)
    return ax


def spread_map(
    field: FieldMap,
    sd: Float[np.ndarray, "y x 2"],
    course: Course,
    *,
    thrust: float,
    route: Float[np.ndarray, "_ 2"],
    suggestion: Float[np.ndarray, "_ 2"] | None = None,
    units: Mapping[str, str] = DIMENSIONLESS,
    ax: Axes | None = None,
) -> Axes:
    """Standard deviation of the learned force, with the route and what to record next.

    Args:
        sd: standard deviation of each component [L T⁻²].
        thrust: top of the colour scale: greatest thrust of the swimmer [L T⁻²].
        route: the planned way [L].
        suggestion: predicted path of the suggested trajectory [L].
    """
    top = min(thrust, max(float(np.nanmax(np.linalg.norm(sd, axis=-1))), 1e-12))
    shown = {"limits": (0.0, top), "shade": None, "units": units}
    ax = map_panel(field, sd, DEVIATION, **shown, ax=ax)
    halo = _halo(BLACK, 2.4)
    ax.plot(*route.T, color=PLAN, lw=1.2, path_effects=halo, label="planned route")
    if suggestion is not None:
        line = {"color": NEXT, "lw": 1.2, "ls": "--", "path_effects": halo}
        ax.plot(*suggestion.T, label="trajectory to record next", **line)
    draw_course(ax, course)
    return ax


def closed_loop_figure(
    result: Navigation, paths: Mapping[str, Sequence[Float[np.ndarray, "_ 2"]]]
) -> Figure:
    """Paths [L] over the true and the learned force, and what is known of it."""
    maps, course, panels = result.maps, result.course, {}
    assert maps is not None
    shown = {"limit": greatest_force(maps), "units": result.units}
    for name, field in (("true force", maps.truth), ("learned force", maps.learned)):
        if field is not None:
            panels[name] = partial(paths_map, field, course, paths, **shown)
    if maps.sd is not None:
        next_one = result.suggestion
        panels["its standard deviation"] = partial(
            spread_map,
            maps.learned,
            maps.sd,
            course,
            thrust=result.thrust,
            route=result.plan.route,
            suggestion=None if next_one is None else next_one.path,
            units=result.units,
        )
    count = len(panels)
    lettered = zip("abc", panels.items(), strict=False)
    panels = {f"({letter}) {name}": draw for letter, (name, draw) in lettered}
    figure = draw_panels((2.7 * count, 3.7) if count > 1 else (4.2, 4.8), panels)
    keys = controller_keys(paths)
    keys += figure.axes[count - 1].get_legend_handles_labels()[0]
    share_legend(figure, keys, columns=min(max(len(keys), 1), 2 * count))
    return figure


def controller_keys(names: Iterable[str]) -> list[Any]:
    """Entries of a legend for controllers."""
    return [Line2D([], [], color=style_of(n).color, lw=1.5, label=n) for n in names]


def greatest_force(maps: ForceMaps) -> float:
    """Top of the colour scale [L T⁻²]: of the true force where that is known."""
    field = maps.learned if maps.truth is None else maps.truth
    return max(float(np.linalg.norm(field.force, axis=-1).max()), 1e-12)


def outcome_bars(
    successes: Mapping[str, Interval], regrets: Mapping[str, Interval]
) -> Figure:
    """Success of each controller, and its regret, with 95 % intervals."""
    names = list(successes)
    figure = new_figure(6.4, 0.9 + 0.32 * len(names))
    left, right = map(prepare_axes, figure.subplots(1, 2, sharey=True))
    places = list(reversed(range(len(names))))
    for place, name in zip(places, names, strict=True):
        color, success = style_of(name).color, successes[name]
        left.barh(place, 100 * success.value, color=color, height=0.6)
        left.hlines(place, 100 * success.lower, 100 * success.upper, color=BLACK)
        if name in regrets:
            _draw_regret(right, place, regrets[name], color)
    left.set_yticks(places, names, fontsize=SMALL)
    left.set_xlim(0, 100)
    right.axvline(1.0, color=GREY, lw=0.8, ls="--")
    low, high = right.get_xlim()
    right.set_xlim(min(low, 0.95), max(high, 1.15))
    right.xaxis.set_major_locator(MaxNLocator(5))
    label_axes(left, "success [%]", "")
    label_axes(right, "arrival time / that with the truth", "")
    return figure


def _draw_regret(ax: Axes, place: int, ratio: Interval, color: str) -> None:
    if not np.isfinite(ratio.value):
        beside = ax.get_yaxis_transform()
        ax.text(0.97, place, "∞", transform=beside, ha="right", va="center", c=color)
        return
    ax.plot(ratio.value, place, "o", color=color, ms=5)
    if np.isfinite(ratio.upper):
        ax.hlines(place, ratio.lower, ratio.upper, color=BLACK)


LOOKS: Mapping[str, tuple[str, str]] = {
    "informed": (NEXT, "-"),
    "random": (GREY, "--"),
    "grid": (PURPLE, "-."),
}
"""Colour and dash of each design."""


def bounds_figure(result: DesignResult) -> Figure:
    """The bound of each campaign after each trajectory, and what was asked for."""
    figure = new_figure(5.2, 3.2)
    ax = prepare_axes(figure.add_subplot())
    for name, curves in result.bounds.items():
        color, dash = LOOKS[name]
        for index, curve in enumerate(curves):
            label = name if index == 0 else None
            ax.plot(100 * curve, color=color, ls=dash, lw=1.2, label=label)
    asked = 100 * result.accuracy
    ax.axhline(asked, color=BLACK, lw=0.8, ls=":", label="asked for")
    ax.set_yscale("log")
    ax.set_ylim(top=110)
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter("")
    label_axes(ax, "trajectories", "bound of the error [%]", legend=1)
    return figure


def recordings_figure(result: DesignResult, design: str) -> Figure:
    """Paths that a design recorded and its way, over the deviation of the force."""
    maps, known = result.maps, {"thrust": result.thrust, "route": result.decision.way}
    assert maps.sd is not None
    figure = new_figure(4.8, 4.8)
    ax = figure.add_subplot()
    spread_map(maps.learned, maps.sd, result.course, **known, ax=ax)
    for index, path in enumerate(result.paths.get(design, ())):
        label = "recorded" if index == 0 else None
        line = {"color": TRACK, "lw": 0.9, "path_effects": _halo(BLACK, 2.0)}
        ax.plot(*path.T, label=label, **line)
    add_legend(ax)
    return figure


Paths = Mapping[str, Sequence[Float[np.ndarray, "_ 3"]]]
"""Positions of the runs of each controller [L]."""

PROJECTIONS = {"(b)": (0, 1), "(c)": (0, 2), "(d)": (1, 2)}
"""Axes of the projections, drawn to the right and upwards."""

ALONG = 24
"""Points along a circle of latitude of a ball in perspective."""


def space_figure(result: Navigation, paths: Paths) -> Figure:
    """Paths [L] in perspective, and their projections along the three axes.

    All panels show the arena whole, lengths along all axes alike.
    """
    figure = new_figure(7.2, 7.4)
    perspective = figure.add_subplot(2, 2, 1, projection="3d")
    _draw_perspective(perspective, result, paths)
    for panel, (letter, axes) in enumerate(PROJECTIONS.items(), start=2):
        ax = prepare_axes(figure.add_subplot(2, 2, panel))
        _draw_projection(ax, result, paths, axes)
        names = "".join("xyz"[axis] for axis in axes)
        label_plane(ax, result.units, adjustable="box", axes=names)
        title_panel(ax, f"{letter} projection on {names}")
    keys = controller_keys(paths)
    keys.append(Line2D([], [], color=PLAN, lw=1.5, ls="--", label="planned route"))
    share_legend(figure, keys, columns=len(keys))
    return figure


def _draw_ways(
    ax: Any, paths: Paths, route: Float[np.ndarray, "_ 3"], axes: Sequence[int]
) -> None:
    """Runs and the planned way along some of the axes."""
    for name, runs in paths.items():
        for path in runs:
            color = style_of(name).color
            ax.plot(*path[:, axes].T, color=color, lw=THIN, alpha=0.75)
    ax.plot(*route[:, axes].T, color=PLAN, lw=1.2, ls="--")


def _draw_perspective(ax: Any, result: Navigation, paths: Paths) -> None:
    course = result.course
    lower, upper = course.arena
    turn, height = np.meshgrid(
        np.linspace(0, 2 * np.pi, ALONG), np.linspace(-np.pi / 2, np.pi / 2, ALONG // 2)
    )
    across = np.cos(height)
    ball = np.stack([across * np.cos(turn), across * np.sin(turn), np.sin(height)])
    for *center, radius in course.discs:
        surface = np.reshape(center, (3, 1, 1)) + radius * ball
        ax.plot_surface(*surface, color=WALL, alpha=0.5)
    _draw_ways(ax, paths, result.plan.route, [0, 1, 2])
    ax.plot(*course.start[:, None], "o", mfc=PAPER, mec=BLACK, ms=5)
    ax.plot(*course.goal[:, None], "x", color=BLACK, ms=6)
    ax.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]))
    ax.set_zlim(lower[2], upper[2])
    ax.set_box_aspect(upper - lower)
    for name in "xyz":
        getattr(ax, f"set_{name}label")(channel_label(name, result.units))
    ax.tick_params(labelsize=SMALL)
    title_panel(cast(Axes, ax), "(a) in perspective")


def _draw_projection(
    ax: Axes, result: Navigation, paths: Paths, axes: tuple[int, int]
) -> None:
    course, shown = result.course, list(axes)
    _draw_ways(ax, paths, result.plan.route, shown)
    projected = Course(
        arena=course.arena[:, shown],
        start=course.start[shown],
        goal=course.goal[shown],
        tolerance=course.tolerance,
        discs=course.discs[:, [*shown, 3]],
    )
    draw_course(ax, projected)
