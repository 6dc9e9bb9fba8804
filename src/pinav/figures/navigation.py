"""Figures of navigation and of designs: plans, routes over the force, outcomes."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float
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
    file_settings,
    label_axes,
    new_figure,
    prepare_axes,
    share_legend,
    style_of,
    title_panel,
    with_unit,
)
from pinav.navigation.maps import Course, ForceMaps
from pinav.navigation.trials.metrics import Interval


def draw_course(ax: Axes, course: Course) -> None:
    """Draw start, goal, obstacles and arena over a map."""
    (x0, y0), (x1, y1) = course.arena
    frame = Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, ec=GREY, lw=0.8)
    ax.add_patch(frame)
    for x, y, radius in course.discs:
        ax.add_patch(Circle((x, y), radius, fc=WALL, ec=BLACK, lw=0.8))
    halo = [withStroke(linewidth=2.5, foreground=PAPER)]
    x, y = course.goal.tolist()
    ring = {"fill": False, "ec": BLACK, "lw": 1.2, "zorder": 5}
    ax.add_patch(Circle((x, y), course.tolerance, **ring))
    ax.plot(x, y, "x", color=BLACK, ms=5, zorder=6, path_effects=halo)
    ax.plot(*course.start, "o", mfc=PAPER, mec=BLACK, ms=5, zorder=6)
    margin = 0.02 * float(max(x1 - x0, y1 - y0))
    ax.set(xlim=(x0 - margin, x1 + margin), ylim=(y0 - margin, y1 + margin))


def plan_grid(arena: Float[np.ndarray, "2 2"], shape: tuple[int, ...]) -> FieldMap:
    """Equally spaced points of an arena as a map without a force.

    Args:
        arena: lower and upper corner [L].
        shape: points along x and y.
    """
    (x0, y0), (x1, y1) = arena
    x, y = np.linspace(x0, x1, shape[0]), np.linspace(y0, y1, shape[1])
    nothing = np.zeros((shape[1], shape[0]))
    return FieldMap(x, y, np.stack([nothing, nothing], axis=-1), nothing)


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
        course: start, goal and obstacles.
        route: the planned way [L].
        units: unit of each channel; "1" means dimensionless.
        ax: where to draw; a new figure unless given.
    """
    grid, values = plan_grid(course.arena, time.shape), time.T
    known = values[np.isfinite(values)]
    top = float(np.quantile(known, 0.98)) if known.size else 1.0
    label = with_unit("time to go from rest", units.get("t", "1"))
    look = Look(f"{GRADED}_r", label, lengths=None, contours=9)
    shown = {"limits": (0.0, top), "shade": None, "units": units}
    ax = map_panel(grid, values, look, **shown, ax=ax)
    hatch_where(ax, grid, ~np.isfinite(values))
    if route is not None:
        halo = [withStroke(linewidth=2.6, foreground=PAPER)]
        ax.plot(*route.T, color=BLACK, lw=1.2, path_effects=halo, zorder=4)
    draw_course(ax, course)
    return ax


def hatch_where(ax: Axes, grid: FieldMap, ground: Bool[np.ndarray, "y x"]) -> None:
    """Hatch a part of a map, if there is any.

    Args:
        ax: the map.
        grid: its points.
        ground: what is hatched.
    """
    if not ground.any():
        return
    with file_settings():
        filled = ground.astype(float)
        ax.contourf(grid.x, grid.y, filled, [0.5, 1.5], colors=[BEYOND], alpha=0.9)
        ax.contourf(grid.x, grid.y, filled, [0.5, 1.5], colors="none", hatches=["///"])


def paths_map(
    field: FieldMap,
    course: Course,
    paths: Mapping[str, Sequence[Float[np.ndarray, "_ 2"]]],
    *,
    limit: float,
    units: Mapping[str, str] = DIMENSIONLESS,
    ax: Axes | None = None,
) -> Axes:
    """Closed-loop paths of controllers over a force.

    Args:
        field: the force.
        course: start, goal and obstacles.
        paths: positions of the runs of each controller [L].
        limit: top of the colour scale [L T⁻²].
        units: unit of each channel; "1" means dimensionless.
        ax: where to draw; a new figure unless given.
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
        field: the learned force.
        sd: standard deviation of each component [L T⁻²].
        course: start, goal and obstacles.
        thrust: top of the colour scale: greatest thrust of the swimmer [L T⁻²].
        route: the planned way [L].
        suggestion: predicted path of the suggested trajectory [L].
        units: unit of each channel; "1" means dimensionless.
        ax: where to draw; a new figure unless given.
    """
    top = min(thrust, max(float(np.nanmax(np.linalg.norm(sd, axis=-1))), 1e-12))
    shown = {"limits": (0.0, top), "shade": None, "units": units}
    ax = map_panel(field, sd, DEVIATION, **shown, ax=ax)
    halo = [withStroke(linewidth=2.4, foreground=BLACK)]
    ax.plot(*route.T, color=PLAN, lw=1.2, path_effects=halo, label="planned route")
    if suggestion is not None:
        line = {"color": NEXT, "lw": 1.2, "ls": "--", "path_effects": halo}
        ax.plot(*suggestion.T, label="trajectory to record next", **line)
    draw_course(ax, course)
    return ax


def closed_loop_figure(
    course: Course,
    maps: ForceMaps,
    paths: Mapping[str, Sequence[Float[np.ndarray, "_ 2"]]],
    *,
    thrust: float,
    route: Float[np.ndarray, "_ 2"],
    suggestion: Float[np.ndarray, "_ 2"] | None = None,
    units: Mapping[str, str] = DIMENSIONLESS,
) -> Figure:
    """Paths over the true and the learned force, and what is known of it.

    Args:
        course: start, goal and obstacles.
        maps: the forces.
        paths: positions of the runs of each controller [L].
        thrust: greatest thrust of the swimmer [L T⁻²].
        route: the planned way [L].
        suggestion: predicted path of the suggested trajectory [L].
        units: unit of each channel; "1" means dimensionless.
    """
    fields = {"true force": maps.truth, "learned force": maps.learned}
    shown = {title: field for title, field in fields.items() if field is not None}
    panels = len(shown) + (maps.sd is not None)
    figure = new_figure(2.7 * panels, 3.7) if panels > 1 else new_figure(4.2, 4.8)
    axes = np.ravel(figure.subplots(1, panels))
    limit = greatest_force(maps)
    for ax, field in zip(axes, shown.values(), strict=False):
        paths_map(field, course, paths, limit=limit, units=units, ax=ax)
    if maps.sd is not None:
        known = {"thrust": thrust, "route": route, "suggestion": suggestion}
        spread_map(maps.learned, maps.sd, course, units=units, ax=axes[-1], **known)
    titles = [*shown, "its standard deviation"]
    for ax, letter, title in zip(axes, "abc", titles, strict=False):
        title_panel(ax, f"({letter}) {title}")
    keys = [Line2D([], [], color=style_of(n).color, lw=1.5, label=n) for n in paths]
    keys += figure.axes[panels - 1].get_legend_handles_labels()[0]
    share_legend(figure, keys, columns=min(max(len(keys), 1), 2 * panels))
    return figure


def greatest_force(maps: ForceMaps) -> float:
    """Top of the colour scale [L T⁻²]: of the true force where that is known."""
    field = maps.learned if maps.truth is None else maps.truth
    return max(float(np.linalg.norm(field.force, axis=-1).max()), 1e-12)


def outcome_bars(
    successes: Mapping[str, Interval], regrets: Mapping[str, Interval]
) -> Figure:
    """Success of each controller, and its regret, with 95 % intervals.

    Args:
        successes: proportion of each controller, with its interval.
        regrets: the same of its regret.
    """
    names = list(successes)
    figure = new_figure(6.4, 0.9 + 0.32 * len(names))
    left, right = figure.subplots(1, 2, sharey=True)
    for ax in (left, right):
        prepare_axes(ax)
    places = list(reversed(range(len(names))))
    for place, name in zip(places, names, strict=True):
        color = style_of(name).color
        success = successes[name]
        value, lower, upper = (
            100 * part for part in (success.value, success.lower, success.upper)
        )
        left.barh(place, value, color=color, height=0.6)
        left.hlines(place, lower, upper, color=BLACK)
        _draw_regret(right, place, regrets.get(name), color)
    left.set_yticks(places, names, fontsize=SMALL)
    left.set_xlim(0, 100)
    right.axvline(1.0, color=GREY, lw=0.8, ls="--")
    low, high = right.get_xlim()
    right.set_xlim(min(low, 0.95), max(high, 1.15))
    right.xaxis.set_major_locator(MaxNLocator(5))
    label_axes(left, "success [%]", "")
    label_axes(right, "arrival time / that with the truth", "")
    return figure


def _draw_regret(ax: Axes, place: int, ratio: Interval | None, color: str) -> None:
    if ratio is None:
        return
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
