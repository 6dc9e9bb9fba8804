"""Figures of bioheat: temperature, dose, probes, protocol and learned perfusion."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter

from pinav.figures.bands import band
from pinav.figures.palette import (
    BLACK,
    BLUE,
    DIVERGING,
    FIELD,
    GRADED,
    GREY,
    LEARNED,
    PAPER,
    TARGET,
    WARM,
)
from pinav.figures.style import (
    SMALL,
    SPARE,
    THIN,
    WIDE,
    add_legend,
    label_axes,
    new_figure,
    prepare_axes,
    style_of,
    title_panel,
)

ISOTHERMS = (39.0, 41.0, 43.0, 45.0, 47.0)
"""Temperatures [°C] that are marked."""

DOSES = (1.0, 10.0, 60.0, 240.0)
"""Doses [CEM43 min] that are marked."""


def profiles(
    radius: Float[np.ndarray, " cell"],
    temperatures: Mapping[str, Float[np.ndarray, " cell"]],
    *,
    edge: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Temperature along the radius, one line for each time.

    Args:
        radius: centres of the cells [m].
        temperatures: [°C], by what the legend says.
        edge: radius of the tumour [m], marked unless None.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    shades = colormaps[GRADED](np.linspace(0.0, 0.85, len(temperatures)))
    for shade, (name, values) in zip(shades, temperatures.items(), strict=True):
        ax.plot(1e3 * radius, values, color=shade, lw=THIN, label=name)
    _mark_edge(ax, edge)
    label_axes(ax, "radius [mm]", "temperature [°C]")
    add_legend(ax)
    return ax


def dose_profile(
    radius: Float[np.ndarray, " cell"],
    dose: Float[np.ndarray, " cell"],
    *,
    edge: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Dose along the radius on a logarithmic scale.

    Args:
        radius: centres of the cells [m].
        dose: CEM43 [min]; what is below a thousandth is left out.
        edge: radius of the tumour [m], marked unless None.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    ax.plot(1e3 * radius, np.where(dose > 1e-3, dose, np.nan), color=BLUE, lw=THIN)
    if np.any(dose > 1e-3):
        ax.set_yscale("log")
        ax.tick_params(which="both", labelsize=SMALL)
    _mark_edge(ax, edge)
    label_axes(ax, "radius [mm]", "dose [CEM43 min]")
    return ax


def _mark_edge(ax: Axes, edge: float | None) -> None:
    if edge is not None:
        ax.axvline(1e3 * edge, color=GREY, lw=0.8, ls=(0, (4, 2)), zorder=1)


def plane_map(
    values: Float[np.ndarray, "row column"],
    spacing: tuple[float, float],
    *,
    levels: Sequence[float],
    label: str,
    axes: tuple[str, str] = ("x", "y"),
    outline: Float[np.ndarray, "row column"] | None = None,
    logarithmic: bool = False,
    limits: tuple[float, float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """A field in a plane with contours, and the outline of the target.

    Args:
        values: along x in rows, along y in columns.
        spacing: of the cells [m].
        levels: of the contours.
        label: of the colour bar.
        axes: names of both axes.
        outline: volume fraction of the target in each cell; outlined at one half.
        logarithmic: colour the logarithm; values below a thousandth as that.
        limits: of the colours; those of the values unless given. About zero, blue is
            below and red above it.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    shown = np.log10(np.maximum(values, 1e-3)) if logarithmic else values
    lowest, highest = np.nanmin(shown), np.nanmax(shown)
    extent = [1e3 * n * h for n, h in zip(values.shape, spacing, strict=True)]
    low, high = limits or (lowest, highest)
    image = ax.imshow(
        shown.T,
        origin="lower",
        extent=(0.0, extent[0], 0.0, extent[1]),
        cmap=DIVERGING if low == -high else WARM,
        vmin=low,
        vmax=high,
    )
    at = np.log10(levels) if logarithmic else np.asarray(levels)
    within = [(a, v) for a, v in zip(at, levels, strict=True)]
    within = [(a, v) for a, v in within if lowest < a < highest]
    centers = [
        1e3 * h * (np.arange(n) + 0.5)
        for n, h in zip(values.shape, spacing, strict=True)
    ]
    if outline is not None and outline.min() < 0.5 < outline.max():
        ax.contour(*centers, outline.T, [0.5], colors=TARGET, linewidths=1.4)
    if within:
        lines = ax.contour(
            *centers, shown.T, [a for a, _ in within], colors=PAPER, linewidths=0.8
        )
        names = ax.clabel(lines, fmt={a: f"{v:g}" for a, v in within}, fontsize=SMALL)
        for name in names:  # readable on light ground, too
            name.set_path_effects([withStroke(linewidth=2.0, foreground=BLACK)])
    figure = ax.figure
    bar = figure.colorbar(image, ax=ax, shrink=0.85)
    bar.set_label(f"log10 of {label}" if logarithmic else label, fontsize=SMALL)
    bar.ax.tick_params(labelsize=SMALL)
    label_axes(ax, f"{axes[0]} [mm]", f"{axes[1]} [mm]")
    return ax


def probe_curves(
    times: Float[np.ndarray, " time"],
    predicted: Float[np.ndarray, "time probe"],
    names: Sequence[str],
    *,
    readings: tuple[np.ndarray, np.ndarray] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Temperature of each probe over time, readings as dots.

    Args:
        times: [s].
        predicted: [°C].
        names: of the probes.
        readings: their times [s], and values [°C] of the same probes.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    for index, name in enumerate(names):
        cycle, shade = divmod(index, len(SPARE))
        color, dash = SPARE[shade], ("-", "--", ":")[cycle % 3]
        if readings is not None:
            at, values = readings
            ax.plot(at / 60, values[:, index], ".", color=color, ms=2, alpha=0.5)
        line = predicted[:, index]
        ax.plot(times / 60, line, dash, color=color, lw=THIN, label=name)
    label_axes(ax, "time [min]", "temperature [°C]")
    add_legend(ax, columns=2)
    return ax


def forecast_figure(
    times: Float[np.ndarray, " time"],
    values: Mapping[str, Float[np.ndarray, " time"]],
    sd: Mapping[str, Float[np.ndarray, " time"]],
    *,
    true: Float[np.ndarray, "curve time"] | None = None,
    fitted_until: float,
) -> Figure:
    """Predicted temperatures; below, how far they may be off, which is much less.

    Args:
        times: [s].
        values: [°C], by what the legend says.
        sd: their standard deviations [K], under the same names.
        true: the same curves of the truth, unless it is not known.
        fitted_until: time [s] of the last reading that was fitted.
    """
    figure = new_figure(5.0, 5.0)
    above, below = figure.subplots(2, 1, sharex=True)
    minutes = times / 60
    for ax in (above, below):
        prepare_axes(ax)
        ax.axvline(fitted_until / 60, color=GREY, lw=0.8, ls=(0, (4, 2)), zorder=1)
    for index, curve in enumerate(() if true is None else true):
        name = "" if index else "truth"
        above.plot(minutes, curve, color=BLACK, lw=WIDE, alpha=0.5, label=name)
    for index, (name, curve) in enumerate(values.items()):
        color, half = SPARE[index % len(SPARE)], 1.96 * sd[name]
        above.plot(minutes, curve, color=color, lw=THIN, label=name)
        drawn = {"color": color, "alpha": 0.12, "width": 0.0}
        band(minutes, 0 * half, (-half, half), **drawn, ax=below)
        for side in (-half, half):
            below.plot(minutes, side, color=color, lw=0.6, ls=(0, (1, 1)))
        if true is not None:
            below.plot(minutes, true[index] - curve, color=color, lw=THIN)
    label_axes(above, "", "temperature [°C]")
    off = "95 % band" if true is None else "truth less predicted"
    label_axes(below, "time [min]", f"{off} [K]")
    add_legend(above, columns=3)
    title_panel(above, "(a) temperature of the target")
    title_panel(below, "(b) 95 % bands about the prediction")
    return figure


def protocol_figure(
    field: tuple[np.ndarray, np.ndarray, np.ndarray],
    times: Float[np.ndarray, " time"],
    temperatures: Mapping[str, Float[np.ndarray, " time"]],
    doses: Mapping[str, Float[np.ndarray, " time"]],
    *,
    fractions: Mapping[str, Float[np.ndarray, " time"]],
    bound: float | None = None,
) -> Figure:
    """Field, temperatures, shares and doses below each other on one axis of time.

    Args:
        field: edges of the intervals [s], amplitudes at their begins and at their
            ends [A m⁻¹].
        times: of the curves [s].
        temperatures: [°C], by what the legend says.
        doses: so far [CEM43 min], by what the legend says.
        fractions: of a volume, 0 to 1, by what the legend says.
        bound: on the temperature, marked unless None.
    """
    figure = new_figure(5.0, 7.5)
    panels = figure.subplots(4, 1, sharex=True)
    for ax in panels:
        prepare_axes(ax)
    above, middle, share_axes, below = panels
    edges, starts, ends = field
    at = np.repeat(np.asarray(edges) / 60, 2)[1:-1]
    values = np.stack([starts, ends], axis=1).reshape(-1)
    above.plot(at, values / 1e3, color=FIELD, lw=THIN)
    above.set_ylim(bottom=0.0)
    label_axes(above, "", "amplitude H [kA/m]")
    for index, (name, curve) in enumerate(temperatures.items()):
        color = style_of(name, index).color
        middle.plot(times / 60, curve, color=color, lw=THIN, label=name)
    if bound is not None:
        middle.axhline(bound, color=GREY, lw=0.8, ls=(0, (4, 2)))
    label_axes(middle, "", "temperature [°C]")
    for color, (name, curve) in zip(SPARE, fractions.items(), strict=False):
        share_axes.plot(times / 60, curve, color=color, lw=THIN, label=name)
    share_axes.set_ylim(-0.05, 1.05)
    label_axes(share_axes, "", "fraction")
    for index, (name, curve) in enumerate(doses.items()):
        shown = np.where(curve > 1e-3, curve, np.nan)
        color = style_of(name, index).color
        below.plot(times / 60, shown, color=color, lw=THIN, label=name)
    if any(np.any(curve > 1e-3) for curve in doses.values()):
        below.set_yscale("log")
        below.tick_params(which="both", labelsize=SMALL)
    label_axes(below, "time [min]", "dose [CEM43 min]")
    add_legend(middle, columns=2)
    add_legend(share_axes)
    add_legend(below)
    names = "(a) field", "(b) temperature", "(c) volume", "(d) dose so far"
    for ax, title in zip(panels, names, strict=True):
        title_panel(ax, title)
    return figure


MANY_TIMES = 4.0
"""Range beyond which the axis of perfusion is logarithmic; below, it had few ticks."""


def perfusion_figure(laws: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Learned perfusion with its 95 % band; pale where the tissue was not.

    Args:
        laws: by tissue: `temperatures` [°C], `values`, `low`, `high` and, where it is
            known, `true` [kg m⁻³ s⁻¹] there, and which of them were `visited`.
    """
    figure = new_figure(3.8 * len(laws), 3.2)
    panels = figure.subplots(1, len(laws), squeeze=False)[0]
    for ax, (name, law) in zip(panels, laws.items(), strict=True):
        perfusion_law(law, ax=ax)
        title_panel(ax, name)
    add_legend(panels[0])
    return figure


def perfusion_law(law: Mapping[str, Any], *, ax: Axes | None = None) -> Axes:
    """The learned perfusion of one tissue with its band, as in `perfusion_figure`.

    Args:
        law: as there.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    temperatures = law["temperatures"]
    visited: Bool[np.ndarray, " temperature"] = np.asarray(law["visited"], bool)
    ends, drawn = (law["low"], law["high"]), {"line": ":", "width": THIN, "alpha": 0.2}
    truth = law.get("true")
    band(temperatures, law["values"], ends, truth=truth, **drawn, ax=ax)
    known = np.where(visited, law["values"], np.nan)
    ax.plot(temperatures, known, color=LEARNED, lw=THIN, label="learned, 95 % band")
    if np.max(law["high"]) > MANY_TIMES * np.min(law["low"]):
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter(FuncFormatter(_even_tick))
    ax.tick_params(which="both", labelsize=SMALL)
    label_axes(ax, "temperature [°C]", "perfusion [kg/(m³ s)]")
    return ax


def _even_tick(value: float, _: int | None = None) -> str:
    """A tick of a logarithmic axis if it begins with 2, 4 or 6; else nothing."""
    return f"{value:g}" if f"{value:e}"[0] in "246" else ""
