"""Figures of bioheat: temperature, dose, probes, protocol and learned perfusion.

Functions of axes draw one panel and return them; the others return the picture of a
result with its words.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from pinav.figures.images import Picture
from pinav.figures.palette import (
    BLACK,
    BLUE,
    DIVERGING,
    FIELD,
    GRADED,
    GREY,
    PAPER,
    TARGET,
    WARM,
)
from pinav.figures.style import (
    SMALL,
    SPARE,
    THIN,
    add_legend,
    draw_panels,
    label_axes,
    mark_line,
    prepare_axes,
    scale_log,
    style_of,
)
from pinav.thermal.heated_run import Cut, HeatedRun
from pinav.thermal.readings import place_names

ISOTHERMS = (39.0, 41.0, 43.0, 45.0, 47.0)
"""Temperatures [°C] that are marked."""

DOSES = (1.0, 10.0, 60.0, 240.0)
"""Doses [CEM43 min] that are marked."""


def profiles(
    radius: Float[np.ndarray, " cell"],
    temperatures: Mapping[str, Float[np.ndarray, " cell"]],
    *,
    edge: float,
    ax: Axes,
) -> None:
    """Temperature along the radius, one line a time, and the edge of the tumour [m]."""
    shades = colormaps[GRADED](np.linspace(0.0, 0.85, len(temperatures)))
    for shade, (name, values) in zip(shades, temperatures.items(), strict=True):
        ax.plot(1e3 * radius, values, color=shade, lw=THIN, label=name)
    mark_line(ax, 1e3 * edge)
    label_axes(ax, "radius [mm]", "temperature [°C]", legend=1)


LEAST_DOSE = 1e-3
"""Doses below this are left out of logarithmic axes [CEM43 min]."""


def dose_curves(
    places: Float[np.ndarray, " place"],
    doses: Mapping[str, Float[np.ndarray, " place"]],
    colors: Sequence[str],
    labels: tuple[str, str],
    *,
    ax: Axes,
) -> Axes:
    """Doses [CEM43 min] on a logarithmic scale, if there are any."""
    for color, (name, dose) in zip(colors, doses.items(), strict=True):
        shown = np.where(dose > LEAST_DOSE, dose, np.nan)
        ax.plot(places, shown, color=color, lw=THIN, label=name)
    scale_log(ax, *(np.where(dose > LEAST_DOSE, dose, 0.0) for dose in doses.values()))
    return label_axes(ax, *labels)


def plane_map(
    values: Float[np.ndarray, "row column"],
    spacing: tuple[float, ...],
    *,
    levels: Sequence[float],
    label: str,
    outline: Float[np.ndarray, "row column"] | None = None,
    logarithmic: bool = False,
    limits: tuple[float, float] | None = None,
    title: str = "",
    ax: Axes,
) -> None:
    """A field in a plane with contours, and the outline of the target.

    Args:
        values: along x in rows, along y in columns.
        spacing: of the cells [m].
        outline: volume fraction of the target in each cell; outlined at one half.
        logarithmic: colour the logarithm; values below a thousandth as that.
        limits: of the colours; those of the values unless given. About zero, blue is
            below and red above it.
    """
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
    drawn = {a: v for a, v in zip(at, levels, strict=True) if lowest < a < highest}
    centers = [
        1e3 * h * (np.arange(n) + 0.5)
        for n, h in zip(values.shape, spacing, strict=True)
    ]
    if outline is not None and outline.min() < 0.5 < outline.max():
        ax.contour(*centers, outline.T, [0.5], colors=TARGET, linewidths=1.4)
    if drawn:
        lines = ax.contour(*centers, shown.T, [*drawn], colors=PAPER, linewidths=0.8)
        words = {a: f"{value:g}" for a, value in drawn.items()}
        for name in ax.clabel(lines, fmt=words, fontsize=SMALL):
            # readable on light ground, too
            name.set_path_effects([withStroke(linewidth=2.0, foreground=BLACK)])
    bar = ax.figure.colorbar(image, ax=ax, shrink=0.85)
    bar.set_label(f"log10 of {label}" if logarithmic else label, fontsize=SMALL)
    bar.ax.tick_params(labelsize=SMALL)
    label_axes(ax, "x [mm]", "y [mm]", title=title)


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
        readings: their times [s], and values [°C] of the same probes.
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
    return label_axes(ax, "time [min]", "temperature [°C]", legend=2)


def fields_figure(run: HeatedRun) -> Picture:
    """Temperature and dose over the radius, or in planes of a box."""
    if run.radius is not None:
        caption = "Temperature over the radius, and dose; the tumour's edge is dashed."
        return titled_picture("fields", run.title, lambda: _radial_figure(run), caption)
    caption = "Temperature at the end, and dose; the tumour is outlined in blue."
    return titled_picture("fields", run.title, lambda: _maps(run), caption)


def titled_picture(
    name: str, title: str, draw: Callable[[], Figure], caption: str
) -> Picture:
    """A figure with the title of its case."""

    def draw_titled() -> Figure:
        figure = draw()
        figure.suptitle(title, fontsize=SMALL + 1)
        return figure

    return Picture(f"heat-{name}", draw_titled, caption, alt=caption)


NUM_PROFILES = 6
"""Number of times at which temperature is drawn over the radius."""


def _radial_figure(run: HeatedRun) -> Figure:
    assert run.radius is not None
    assert run.profiles is not None
    inside, step = run.radius[run.target > 0.5], float(np.diff(run.radius)[0])
    # the volume fraction of the tumour passes one half at its edge
    edge = float(inside.max() + step / 2) if inside.size else 0.0
    last = len(run.times) - 1
    steps = np.unique(np.linspace(0, last, NUM_PROFILES + 1).astype(int)[1:])
    lines = {duration(float(run.times[i])): run.profiles[i] for i in steps}
    labels = "radius [mm]", "dose [CEM43 min]"
    dose = partial(dose_curves, 1e3 * run.radius, {"": run.dose}, [BLUE], labels)
    panels = [
        partial(profiles, run.radius, lines, edge=edge),
        lambda ax: mark_line(dose(ax=ax), 1e3 * edge),
    ]
    return draw_panels((7.5, 3.4), panels)


def _maps(run: HeatedRun) -> Figure:
    """Sections through the hottest cell and through the middle of the tumour."""
    cuts = sections_through(run.target, run.temperature, run.spacing)
    panels = []
    for name, cut in cuts.items():
        shown = {"spacing": run.spacing[:2], "outline": cut.of(run.target)}
        heat = partial(plane_map, levels=ISOTHERMS, label="temperature [°C]", **shown)
        dose = partial(plane_map, levels=DOSES, label="CEM43 [min]", **shown)
        panels.append(partial(heat, cut.of(run.temperature), title=name))
        panels.append(partial(dose, cut.of(run.dose), logarithmic=True))
    return draw_panels((7.5, 3.2 * len(cuts)), panels, columns=2)


def sections_through(
    target: Float[np.ndarray, "..."],
    temperature: Float[np.ndarray, "..."],
    spacing: tuple[float, ...],
) -> dict[str, Cut]:
    """Planes through the hottest cell and through the middle of the target.

    Args:
        target: volume fraction of the target in each cell.
        temperature: temperature of each cell [°C].
        spacing: edges of a cell [m].

    Returns:
        The planes by their titles.
    """
    if target.ndim == 2:
        return {"": Cut(2, None)}
    hottest = np.unravel_index(np.nanargmax(temperature), temperature.shape)
    mass = target.sum(axis=(0, 1))
    middle = round(float(mass @ np.arange(mass.size) / mass.sum()))
    cuts: dict[int, list[str]] = {}
    for name, index in (("hottest cell", int(hottest[2])), ("tumour", middle)):
        cuts.setdefault(index, []).append(name)
    return {
        f"z = {1e3 * spacing[2] * (index + 0.5):.4g} mm, {' and '.join(names)}": Cut(
            2, index
        )
        for index, names in cuts.items()
    }


def duration(seconds: float) -> str:
    """A time for a legend, exact to a thousandth of a second."""
    minutes = seconds / 60
    if abs(minutes - round(minutes)) < 1e-9:
        return f"{round(minutes)} min"
    return f"{round(seconds, 3):.10g} s"


def probes_figure(run: HeatedRun) -> Picture:
    """Temperature of each probe of a run."""
    assert run.probes is not None
    draw = partial(probe_curves, run.times, run.probes, place_names(run.points))
    caption = "Temperature of each probe."
    return titled_picture("probes", run.title, lambda: figure_of(draw()), caption)


def figure_of(ax: Axes) -> Figure:
    """The figure that axes belong to."""
    figure = ax.get_figure(root=True)
    assert figure is not None
    return figure


def protocol_figure(run: HeatedRun, bound: float | None = None) -> Picture:
    """Field, temperatures, shares and doses of a run, and a bound [°C]."""
    caption = (
        "Peak amplitude of the field; the hottest cell and the temperatures that 10, "
        "50 and 90 % of the tumour exceed; the fraction of it above 43 °C; doses so "
        "far."
    )
    return titled_picture("protocol", run.title, lambda: _protocol(run, bound), caption)


def _protocol(run: HeatedRun, bound: float | None) -> Figure:
    """Panels below each other on one axis of time."""
    panels = {
        "(a) field": partial(_field, run),
        "(b) temperature": partial(_temperatures, run, bound),
        "(c) volume": partial(_volume, run),
        "(d) dose so far": partial(_doses, run),
    }
    return draw_panels((5.0, 7.5), panels, columns=1, sharex=True)


def _field(run: HeatedRun, *, ax: Axes) -> None:
    field = run.protocol
    at = np.repeat(np.asarray(field.edges) / 60, 2)[1:-1]
    values = np.stack([field.starts, field.ends], axis=1).reshape(-1)
    ax.plot(at, values / 1e3, color=FIELD, lw=THIN)
    ax.set_ylim(bottom=0.0)
    label_axes(ax, "", "amplitude H [kA/m]")


def _temperatures(run: HeatedRun, bound: float | None, *, ax: Axes) -> None:
    for index, (name, curve) in enumerate(run.temperatures.items()):
        label = {"hottest": "hottest cell"}.get(name, name)
        color = style_of(label, index).color
        ax.plot(run.times / 60, curve, color=color, lw=THIN, label=label)
    if bound is not None:
        ax.axhline(bound, color=GREY, lw=0.8, ls=(0, (4, 2)))
    label_axes(ax, "", "temperature [°C]", legend=2)


def _volume(run: HeatedRun, *, ax: Axes) -> None:
    label = "V43, of the tumour above 43 °C"
    ax.plot(run.times / 60, run.above, color=SPARE[0], lw=THIN, label=label)
    ax.set_ylim(-0.05, 1.05)
    label_axes(ax, "", "fraction", legend=1)


def _doses(run: HeatedRun, *, ax: Axes) -> None:
    names = {"D90": "D90 of the tumour", "outside": "largest outside it"}
    doses = {names[name]: curve for name, curve in run.doses.items()}
    colors = [style_of(name, index).color for index, name in enumerate(doses)]
    labels = "time [min]", "dose [CEM43 min]"
    add_legend(dose_curves(run.times / 60, doses, colors, labels, ax=ax))
