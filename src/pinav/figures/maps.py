"""Maps of quantities in the plane, which show where there was data and where not."""

import dataclasses
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import (
    FuncFormatter,
    LogLocator,
    MaxNLocator,
    NullLocator,
    ScalarFormatter,
)

from pinav.analysis import LyapunovMap
from pinav.evaluation import FieldMap
from pinav.figures.palette import (
    BEYOND,
    BLACK,
    FAINT,
    GRADED,
    PAPER,
    UNCERTAIN,
    VERMILLION,
    WRONG,
)
from pinav.figures.style import (
    DIMENSIONLESS,
    SMALL,
    TEXT,
    draw_panels,
    file_settings,
    label_plane,
    prepare_axes,
    with_unit,
)
from pinav.units import force_unit

ARROWS = 15
"""Most arrows along each side of a map."""

SIGNIFICANT = 2.0
"""Below this ratio of size to standard deviation a force may as well be zero."""

Path = Float[np.ndarray, "time 2"]
"""Positions that are drawn over a map [L]; a row of NaN separates trajectories."""


@dataclasses.dataclass(frozen=True)
class Look:
    """Appearance of a quantity in the plane.

    Attributes:
        colors: name of the colour map.
        quantity: symbol or words at the colour bar.
        lengths: power of the length in its unit: 1 of a force, 2 of an energy; None
            where `quantity` has its unit already, or none.
        has_arrows: the direction of a vector is drawn.
        contours: number of white contours between the limits of the colours.
        marked: a level that is marked and labelled; None for none.
        is_logarithmic: the colours are those of the logarithm.
    """

    colors: str
    quantity: str
    lengths: int | None = 1
    has_arrows: bool = False
    contours: int = 0
    marked: float | None = None
    is_logarithmic: bool = False


FORCE = Look(GRADED, "$|F|$", has_arrows=True)
ERROR = Look(WRONG, r"$|F - F^*|$")
DEVIATION = Look(UNCERTAIN, r"$\mathrm{sd}(F)$")
CHANGE = Look(WRONG, r"$|\Delta F|$", has_arrows=True)
POTENTIAL = Look(GRADED, "$U$ above its least value", lengths=2, contours=7)
TRUST = Look(
    UNCERTAIN, r"$|F| / \mathrm{sd}(F)$", None, marked=SIGNIFICANT, is_logarithmic=True
)
GROWTH = Look(
    UNCERTAIN, r"growth of separations, $e^{\lambda T}$", None, is_logarithmic=True
)


def map_panel(
    grid: FieldMap | LyapunovMap,
    values: Float[np.ndarray, "rows columns *component"],
    look: Look,
    *,
    limits: tuple[float, float] | None = None,
    path: Path | None = None,
    shade: bool | None = True,
    units: Mapping[str, str] = DIMENSIONLESS,
    ax: Axes | None = None,
) -> Axes:
    """A quantity in colour over the plane, with its colour bar; axes of equal scale.

    Args:
        grid: the map that has the coordinates of the grid [L], and its distance from
            the data.
        values: the quantity at each grid point, not drawn where it is not finite; of a
            vector its size, and its direction in arrows.
        limits: of the colours, shared between maps that are to be compared; from 0 to
            the largest size near the data unless given.
        path: positions to overlay [L].
        shade: grey out what is not near the data. A learned force is extrapolated
            there; a true one is not. None marks no data at all.
    """
    size = np.linalg.norm(values, axis=-1) if values.ndim == 3 else values
    if limits is None:
        assert isinstance(grid, FieldMap)
        limits = 0.0, largest_near(size, grid)
    norm = (LogNorm if look.is_logarithmic else Normalize)(*limits)
    ax = prepare_axes(ax, width=3.8, height=4.4)
    image = ax.pcolormesh(
        grid.x,
        grid.y,
        np.ma.masked_invalid(size),
        cmap=look.colors,
        norm=norm,
        shading="nearest",
        rasterized=True,
    )
    label = look.quantity
    if look.lengths is not None:
        label = with_unit(label, force_unit(units, lengths=look.lengths))
    place = {"location": "bottom", "aspect": 30, "pad": 0.02}
    bar = ax.figure.colorbar(image, ax=ax, extend=_extend(size, norm), **place)
    bar.set_label(label, fontsize=TEXT)
    bar.ax.tick_params(labelsize=SMALL, length=2.5, width=0.6)
    bar.ax.xaxis.get_offset_text().set_fontsize(SMALL)
    bar.outline.set_linewidth(0.6)
    _few_labels(bar, norm)
    label_plane(ax, units, adjustable="box")
    _draw_contours(ax, grid, size, look, limits)
    if look.has_arrows:
        draw_arrows(ax, grid.x, grid.y, values, limits[1])
    if isinstance(grid, FieldMap) and shade is not None:
        _mark_data(ax, grid, path, units, shade=shade)
    ax.set(xlim=grid.x[[0, -1]], ylim=grid.y[[0, -1]])
    return ax


def _draw_contours(
    ax: Axes,
    grid: FieldMap | LyapunovMap,
    size: Float[np.ndarray, "rows columns"],
    look: Look,
    limits: tuple[float, float],
) -> None:
    if look.contours:
        levels = np.linspace(*limits, look.contours + 2)[1:-1]
        shown = np.ma.masked_invalid(size)
        ax.contour(grid.x, grid.y, shown, levels, colors=PAPER, linewidths=0.5)
    if look.marked is not None and size.min() < look.marked < size.max():
        line = {"colors": VERMILLION, "linewidths": 1.2}
        drawn = ax.contour(grid.x, grid.y, size, [look.marked], **line)
        ax.clabel(drawn, fmt={look.marked: f"{look.marked:g}"}, fontsize=SMALL)


def above_least(
    potential: Float[np.ndarray, "rows columns"], field: FieldMap
) -> Float[np.ndarray, "rows columns"]:
    """A potential, up to a constant: its least value near the data is zero."""
    near = (field.distance <= field.regions.near) & np.isfinite(potential)
    near = near if near.any() else np.isfinite(potential)
    return potential - potential[near].min()


def trust_map(
    field: FieldMap, sd: Float[np.ndarray, "rows columns 2"], **shown: Any
) -> Axes:
    """Signal to noise: size of a learned force over its standard deviation.

    A line surrounds places where the force is known to better than half of its size.

    Args:
        sd: standard deviation of each component [L T⁻²].
        shown: as of `map_panel`.
    """
    size = np.linalg.norm(field.force, axis=-1)
    ratio = size / np.maximum(np.linalg.norm(sd, axis=-1), 1e-300)
    limits = 0.1, max(10.0, float(np.nanmax(ratio)))
    return map_panel(field, ratio, TRUST, limits=limits, **shown)


def force_comparison(
    learned: FieldMap,
    *,
    true: FieldMap | None = None,
    sd: Float[np.ndarray, "rows columns 2"] | None = None,
    path: Path | None = None,
    units: Mapping[str, str] = DIMENSIONLESS,
) -> Figure:
    """A learned force beside the truth and its error, and beside its uncertainty.

    Args:
        true: the true force on the same grid, where it is known.
        sd: standard deviation of the learned force [L T⁻²], where it is known.
        path: positions to overlay [L].
    """
    field = learned if true is None else true
    size = np.linalg.norm(field.force, axis=-1)
    top = float(np.nanmax(size)) if true is not None else largest_near(size, learned)
    panel = partial(map_panel, path=path, units=units)
    shared = partial(panel, look=FORCE, limits=(0.0, top))
    panels = {"learned": partial(shared, learned, learned.force)}
    if true is not None:
        panels = {"true": partial(shared, true, true.force, shade=False), **panels}
        panels["error"] = partial(panel, true, learned.force - true.force, ERROR)
    if sd is not None:
        panels["standard deviation"] = partial(panel, learned, sd, DEVIATION)
    columns = 2 if len(panels) == 4 else len(panels)
    shape = 2.5 * max(columns, 2), 3.5 * -(-len(panels) // columns)
    lettered = zip("abcd", panels.items(), strict=False)
    panels = {f"({letter}) {name}": draw for letter, (name, draw) in lettered}
    legend = 4 if columns > 2 else 2
    return draw_panels(shape, panels, columns=columns, legend=legend)


def largest_near(magnitude: np.ndarray, field: FieldMap) -> float:
    """Largest finite magnitude near the data, or anywhere if there is none."""
    near = magnitude[(field.distance <= field.regions.near) & np.isfinite(magnitude)]
    values = near if near.size else magnitude[np.isfinite(magnitude)]
    return float(values.max(initial=0.0)) or 1.0


def _few_labels(bar: Colorbar, norm: Normalize) -> None:
    """Labels of a colour bar that do not run into each other."""
    if not isinstance(norm, LogNorm):
        bar.locator = MaxNLocator(nbins=5, steps=[1, 2, 5, 10])
        bar.formatter = ScalarFormatter()
        bar.formatter.set_powerlimits((-2, 4))
        return
    low, high = bar.mappable.get_clim()
    decades = np.log10((high or 1.0) / (low or 1.0))
    subs = (1.0, 2.0, 5.0) if decades < 2 else (1.0,)
    axis = bar.ax.xaxis
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def _extend(values: np.ndarray, norm: Normalize) -> str:
    """Which ends of the colour bar are pointed: where values lie beyond."""
    slack = 1.0 + 1e-9
    above = norm.vmax is not None and bool((values > norm.vmax * slack).any())
    below = norm.vmin is not None and bool((values < norm.vmin / slack).any())
    return {(False, False): "neither", (True, False): "max", (False, True): "min"}.get(
        (above, below), "both"
    )


def draw_arrows(
    ax: Axes,
    x: Float[np.ndarray, " columns"],
    y: Float[np.ndarray, " rows"],
    vectors: Float[np.ndarray, "rows columns 2"],
    top: float,
) -> None:
    """Arrows on a coarser grid, none longer than the distance between two.

    Vectors larger than `top` are drawn like it.
    """
    rows, columns = (
        slice((n - 1) % stride // 2, None, stride)
        for n in vectors.shape[:2]
        for stride in [-(-n // ARROWS)]
    )
    x, y, force = x[columns], y[rows], vectors[rows, columns]
    size = np.linalg.norm(force, axis=-1, keepdims=True)
    force = force * np.minimum(1.0, top / np.maximum(size, 1e-300))
    spacing = float(max(np.ptp(x) / max(len(x) - 1, 1), 1e-300))
    ax.quiver(
        x,
        y,
        *np.moveaxis(force, -1, 0),
        color=PAPER,
        edgecolor=BLACK,
        linewidth=0.3,
        angles="xy",
        scale_units="xy",
        scale=top / (1.2 * spacing),
        pivot="mid",
        width=0.008,
    )


def _mark_data(
    ax: Axes,
    field: FieldMap,
    path: np.ndarray | None,
    units: Mapping[str, str],
    *,
    shade: bool,
) -> None:
    """Grey regions without data, contours of visited and near ones, the path, keys."""
    lowest, highest = float(field.distance.min()), float(field.distance.max())
    places, near = (field.x, field.y, field.distance), field.regions.near
    length = with_unit("", units.get("x", "1")).strip(" []")
    outline = [withStroke(linewidth=1.8, foreground=FAINT)]
    with file_settings():
        label = "no data: extrapolation"
        beyond = Patch(facecolor=BEYOND, hatch="////", label=label)
        if shade and highest > near:
            levels = [near, highest]
            ax.contourf(*places, levels, colors=[BEYOND], alpha=0.85)
            ax.contourf(*places, levels, colors="none", hatches=["////"])
    keys: list[Line2D | Patch] = []
    for name, level, color, dash, effects in (
        ("visited", field.regions.visited, PAPER, "solid", outline),
        ("near", near, BLACK, "dashed", []),
    ):
        if lowest < level < highest:
            line = {"colors": color, "linestyles": dash, "linewidths": 0.8}
            ax.contour(*places, [level], **line)
        label = f"{name} ({f'within {level:.3g} {length}'.strip()})"
        drawn = {"color": color, "ls": dash, "lw": 0.8, "path_effects": effects}
        keys.append(Line2D([], [], label=label, **drawn))
    if path is not None:
        ax.plot(*path.T, **_PATH)
        keys.insert(0, Line2D([], [], label="trajectory", **_PATH))
    if shade:
        keys.append(beyond)
    ax.legend(handles=keys, loc="upper left", fontsize=SMALL, framealpha=0.9)


_PATH = {
    "color": PAPER,
    "lw": 1.0,
    "path_effects": [withStroke(linewidth=2.2, foreground=BLACK)],
}
