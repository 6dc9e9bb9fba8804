"""Maps of planar force fields, which show where there was data and where not."""

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
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
from pinav.evaluation import FieldMap, Regions
from pinav.figures.palette import (
    BEYOND,
    BLACK,
    FAINT,
    GRADED,
    PAPER,
    UNCERTAIN,
    WRONG,
)
from pinav.figures.style import (
    DIMENSIONLESS,
    SMALL,
    TEXT,
    file_settings,
    label_plane,
    new_figure,
    prepare_axes,
    share_legend,
    title_panel,
    with_unit,
)
from pinav.units import force_unit

ARROWS = 15
"""Most arrows along each side of a map."""


def force_map(
    field: FieldMap,
    *,
    path: Float[np.ndarray, "time 2"] | None = None,
    limit: float | None = None,
    shade: bool = True,
    units: Mapping[str, str] = DIMENSIONLESS,
    ax: Axes | None = None,
) -> Axes:
    """A force field: its magnitude in colour, its direction in arrows.

    Args:
        field: the force on a grid, and the distance of the grid from the data.
        path: positions to overlay [L]; a row of NaN separates two trajectories.
        limit: top of the colour scale [L T⁻²], shared between maps that are to be
            compared; the largest magnitude near the data unless given.
        shade: grey out what is not near the data. A learned force
            is extrapolated there; a true one is not.
        units: unit of each channel; "1" means dimensionless.
        ax: where to draw; a new figure unless given.
    """
    magnitude = np.linalg.norm(field.force, axis=-1)
    top = largest_near(magnitude, field) if limit is None else limit
    ax = _magnitude_map(magnitude, field, top, (GRADED, "$|F|$"), units, ax)
    draw_arrows(ax, field, top)
    overlay(ax, field, path, units, shade=shade)
    return ax


def force_error_map(
    learned: FieldMap,
    true: FieldMap,
    *,
    path: Float[np.ndarray, "time 2"] | None = None,
    limit: float | None = None,
    units: Mapping[str, str] = DIMENSIONLESS,
    ax: Axes | None = None,
) -> Axes:
    """Magnitude of the difference between a learned and the true force.

    Args:
        learned: the learned force.
        true: the true force on the same grid.
        path: as for `force_map`.
        limit: as for `force_map`.
        units: unit of each channel; "1" means dimensionless.
        ax: where to draw; a new figure unless given.
    """
    error = np.linalg.norm(learned.force - true.force, axis=-1)
    top = largest_near(error, true) if limit is None else limit
    ax = _magnitude_map(error, true, top, (WRONG, r"$|F - F^*|$"), units, ax)
    overlay(ax, true, path, units, shade=True)
    return ax


def force_sd_map(
    field: FieldMap,
    sd: Float[np.ndarray, "rows columns 2"],
    *,
    path: Float[np.ndarray, "time 2"] | None = None,
    limit: float | None = None,
    units: Mapping[str, str] = DIMENSIONLESS,
    ax: Axes | None = None,
) -> Axes:
    """Posterior standard deviation of a learned force: root sum of both components.

    Args:
        field: the learned force.
        sd: standard deviation of each component of it [L T⁻²].
        path: as for `force_map`.
        limit: as for `force_map`.
        units: unit of each channel; "1" means dimensionless.
        ax: where to draw; a new figure unless given.
    """
    size = np.linalg.norm(sd, axis=-1)
    top = largest_near(size, field) if limit is None else limit
    ax = _magnitude_map(size, field, top, (UNCERTAIN, r"$\mathrm{sd}(F)$"), units, ax)
    overlay(ax, field, path, units, shade=True)
    return ax


def force_comparison(
    learned: FieldMap,
    *,
    true: FieldMap | None = None,
    sd: Float[np.ndarray, "rows columns 2"] | None = None,
    path: Float[np.ndarray, "time 2"] | None = None,
    units: Mapping[str, str] = DIMENSIONLESS,
) -> Figure:
    """A learned force beside the truth and its error, and beside its uncertainty.

    Args:
        learned: the learned force.
        true: the true force on the same grid, where it is known.
        sd: standard deviation of the learned force [L T⁻²], where it is known.
        path: as for `force_map`.
        units: unit of each channel; "1" means dimensionless.
    """
    sizes = [np.linalg.norm(f.force, axis=-1) for f in (true, learned) if f is not None]
    top = (
        float(np.nanmax(sizes[0]))
        if true is not None
        else largest_near(sizes[0], learned)
    )
    shared = {"path": path, "units": units}
    panels = {"learned": partial(force_map, learned, limit=top, **shared)}
    if true is not None:
        truth = partial(force_map, true, limit=top, shade=False, **shared)
        error = partial(force_error_map, learned, true, **shared)
        panels = {"true": truth, **panels, "error": error}
    if sd is not None:
        panels["standard deviation"] = partial(force_sd_map, learned, sd, **shared)
    return _arrange_panels(panels, learned.regions, units, path=path is not None)


def _arrange_panels(
    panels: Mapping[str, Callable[..., Axes]],
    regions: Regions,
    units: Mapping[str, str],
    *,
    path: bool,
) -> Figure:
    """Panels side by side, four of them in a square, over one legend."""
    columns = 2 if len(panels) == 4 else len(panels)
    rows = -(-len(panels) // columns)
    figure = new_figure(2.5 * max(columns, 2), 3.5 * rows)
    axes = np.ravel(figure.subplots(rows, columns))
    for index, (ax, (name, draw)) in enumerate(zip(axes, panels.items(), strict=True)):
        draw(ax=ax)
        title_panel(ax, f"({'abcd'[index]}) {name}")
        legend = ax.get_legend()
        if legend is not None:
            legend.remove()
        if index % columns:
            ax.set_ylabel("")
    keys = _keys(regions, units, path=path, shade=True)
    share_legend(figure, keys, columns=4 if columns > 2 else 2)
    return figure


def largest_near(magnitude: np.ndarray, field: FieldMap) -> float:
    """Largest finite magnitude near the data, or anywhere if there is none."""
    near = magnitude[(field.distance <= field.regions.near) & np.isfinite(magnitude)]
    values = near if near.size else magnitude[np.isfinite(magnitude)]
    return float(values.max(initial=0.0)) or 1.0


def _magnitude_map(
    magnitude: np.ndarray,
    field: FieldMap,
    top: float,
    look: tuple[str, str],
    units: Mapping[str, str],
    ax: Axes | None,
) -> Axes:
    cmap, quantity = look
    label = with_unit(quantity, force_unit(units))
    norm = Normalize(0.0, top)
    return heat_map(magnitude, field, norm, (cmap, label), units=units, ax=ax)


def heat_map(
    values: Float[np.ndarray, "rows columns"],
    grid: FieldMap | LyapunovMap,
    norm: Normalize,
    look: tuple[str, str],
    *,
    units: Mapping[str, str] = DIMENSIONLESS,
    ax: Axes | None = None,
) -> Axes:
    """A quantity in colour over the plane, with its colour bar; axes of equal scale.

    Args:
        values: the quantity at each grid point; not drawn where it is not finite.
        grid: what has the coordinates `x` and `y` of the grid [L].
        norm: scale of the colours, with its limits.
        look: name of the colour map, and label of the colour bar with its unit.
        units: unit of each channel; "1" means dimensionless.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax, width=3.8, height=4.4)
    image = ax.pcolormesh(
        grid.x,
        grid.y,
        np.ma.masked_invalid(values),
        cmap=look[0],
        norm=norm,
        shading="nearest",
        rasterized=True,
    )
    bar = ax.figure.colorbar(
        image,
        ax=ax,
        location="bottom",
        aspect=30,
        pad=0.02,
        extend=_extend(values, norm),
    )
    bar.set_label(look[1], fontsize=TEXT)
    bar.ax.tick_params(labelsize=SMALL, length=2.5, width=0.6)
    bar.ax.xaxis.get_offset_text().set_fontsize(SMALL)
    bar.outline.set_linewidth(0.6)
    _few_labels(bar, norm)
    label_plane(ax, units, adjustable="box")
    return ax


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


def draw_arrows(ax: Axes, field: FieldMap, top: float) -> None:
    """Arrows on a coarser grid, none longer than the distance between two."""
    rows, columns = (
        slice((n - 1) % stride // 2, None, stride)
        for n in field.distance.shape
        for stride in [-(-n // ARROWS)]
    )
    x, y = field.x[columns], field.y[rows]
    force = field.force[rows, columns]
    size = np.linalg.norm(force, axis=-1, keepdims=True)
    force = force * np.minimum(1.0, top / np.maximum(size, 1e-300))
    spacing = float(max(np.ptp(x) / max(len(x) - 1, 1), 1e-300))
    ax.quiver(
        x,
        y,
        force[..., 0],
        force[..., 1],
        color=PAPER,
        edgecolor=BLACK,
        linewidth=0.3,
        angles="xy",
        scale_units="xy",
        scale=top / (1.2 * spacing),
        pivot="mid",
        width=0.008,
    )


def overlay(
    ax: Axes,
    field: FieldMap,
    path: np.ndarray | None,
    units: Mapping[str, str],
    *,
    shade: bool,
) -> None:
    """Grey regions without data, contours of visited and near ones, the path."""
    lowest, highest = float(field.distance.min()), float(field.distance.max())
    visited, near = field.regions.visited, field.regions.near
    with file_settings():
        if shade and highest > near:
            beyond = (field.x, field.y, field.distance, [near, highest])
            ax.contourf(*beyond, colors=[BEYOND], alpha=0.85)
            ax.contourf(*beyond, colors="none", hatches=["////"])
    for level, dash in ((visited, "solid"), (near, "dashed")):
        if lowest < level < highest:
            ax.contour(
                field.x,
                field.y,
                field.distance,
                [level],
                colors=PAPER if level == visited else BLACK,
                linewidths=0.8,
                linestyles=dash,
            )
    if path is not None:
        ax.plot(*path.T, **_PATH)
    ax.set(xlim=field.x[[0, -1]], ylim=field.y[[0, -1]])
    handles = _keys(field.regions, units, path=path is not None, shade=shade)
    ax.legend(handles=handles, loc="upper left", fontsize=SMALL, framealpha=0.9)


_PATH = {
    "color": PAPER,
    "lw": 1.0,
    "path_effects": [withStroke(linewidth=2.2, foreground=BLACK)],
}


def _keys(
    regions: Regions, units: Mapping[str, str], *, path: bool, shade: bool
) -> list[Artist]:
    """Legend entries of what `overlay` draws."""
    length = with_unit("", units.get("x", "1")).strip(" []")
    visited, near = (
        f"within {d:.3g} {length}".strip() for d in (regions.visited, regions.near)
    )
    outline = [withStroke(linewidth=1.8, foreground=FAINT)]
    keys: list[Artist] = []
    if path:
        keys.append(Line2D([], [], label="trajectory", **_PATH))
    observed = {"color": PAPER, "lw": 0.8, "path_effects": outline}
    keys.append(Line2D([], [], label=f"visited ({visited})", **observed))
    dashed = {"color": BLACK, "lw": 0.8, "ls": "dashed"}
    keys.append(Line2D([], [], label=f"near ({near})", **dashed))
    if shade:
        with file_settings():
            label = "no data: extrapolation"
            keys.append(Patch(facecolor=BEYOND, hatch="////", label=label))
    return keys
