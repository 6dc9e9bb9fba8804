"""Figures of bioheat: temperature, dose, probes, protocol and learned perfusion.

Functions of axes draw one panel and return them; the others return the picture of a
result with its words.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

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
    label_axes,
    new_figure,
    prepare_axes,
    style_of,
    title_panel,
)
from pinav.thermal.heated_run import HeatedRun

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
    figure = new_figure(7.5, 3.4)
    left, right = figure.subplots(1, 2)
    inside, step = run.radius[run.target > 0.5], float(np.diff(run.radius)[0])
    # the volume fraction of the tumour passes one half at its edge
    edge = float(inside.max() + step / 2) if inside.size else 0.0
    last = len(run.times) - 1
    steps = np.unique(np.linspace(0, last, NUM_PROFILES + 1).astype(int)[1:])
    lines = {duration(float(run.times[i])): run.profiles[i] for i in steps}
    profiles(run.radius, lines, edge=edge, ax=left)
    dose_profile(run.radius, run.dose, edge=edge, ax=right)
    return figure


def _maps(run: HeatedRun) -> Figure:
    """Sections through the hottest cell and through the middle of the tumour."""
    cuts = sections_through(run.target, run.temperature, run.spacing)
    figure = new_figure(7.5, 3.2 * len(cuts))
    panels = figure.subplots(len(cuts), 2, squeeze=False)
    for row, cut in zip(panels, cuts, strict=True):
        for ax, values, levels, label in (
            (row[0], run.temperature, ISOTHERMS, "temperature [°C]"),
            (row[1], run.dose, DOSES, "CEM43 [min]"),
        ):
            plane_map(
                cut.of(values),
                (run.spacing[0], run.spacing[1]),
                levels=levels,
                label=label,
                outline=cut.of(run.target),
                logarithmic=values is run.dose,
                ax=ax,
            )
        title_panel(row[0], cut.name)
    return figure


class MapSection(NamedTuple):
    """A plane in which a field is drawn.

    Attributes:
        name: what its title says.
        place: index of the cells along the third axis; none where the field is a plane.
    """

    name: str
    place: int | None

    def of(self, field: Float[np.ndarray, "..."]) -> Float[np.ndarray, "row column"]:
        """The cells of a field that lie in the plane."""
        return field if self.place is None else field[:, :, self.place]


def sections_through(
    target: Float[np.ndarray, "..."],
    temperature: Float[np.ndarray, "..."],
    spacing: tuple[float, ...],
) -> list[MapSection]:
    """Planes through the hottest cell and through the middle of the target.

    Args:
        target: volume fraction of the target in each cell.
        temperature: temperature of each cell [°C].
        spacing: edges of a cell [m].
    """
    if target.ndim == 2:
        return [MapSection("", None)]
    hottest = np.unravel_index(np.nanargmax(temperature), temperature.shape)
    mass = target.sum(axis=(0, 1))
    middle = round(float(mass @ np.arange(mass.size) / mass.sum()))
    cuts: dict[int, list[str]] = {}
    for name, index in (("hottest cell", int(hottest[2])), ("tumour", middle)):
        cuts.setdefault(index, []).append(name)
    return [
        MapSection(
            f"z = {1e3 * spacing[2] * (index + 0.5):.4g} mm, {' and '.join(names)}",
            index,
        )
        for index, names in cuts.items()
    ]


def duration(seconds: float) -> str:
    """A time for a legend, exact to a thousandth of a second."""
    minutes = seconds / 60
    if abs(minutes - round(minutes)) < 1e-9:
        return f"{round(minutes)} min"
    return f"{round(seconds, 3):.10g} s"


def probes_figure(run: HeatedRun) -> Picture:
    """Temperature of each probe of a run."""
    probes = run.probes
    assert probes is not None
    return titled_picture(
        "probes",
        run.title,
        lambda: figure_of(probe_curves(run.times, probes, place_names(run.points))),
        "Temperature of each probe.",
    )


def place_names(points: Float[np.ndarray, "probe axis"]) -> list[str]:
    """Names of probes by their places [m]."""
    return [", ".join(f"{1e3 * x:g}" for x in point) + " mm" for point in points]


def figure_of(ax: Axes) -> Figure:
    """The figure that axes belong to."""
    figure = ax.get_figure(root=True)
    assert figure is not None
    return figure


def protocol_figure(run: HeatedRun, bound: float | None = None) -> Picture:
    """Field, temperatures, shares and doses of a run.

    Args:
        run: the run.
        bound: bound of the temperature [°C], marked unless None.
    """
    caption = (
        "Peak amplitude of the field; the hottest cell and the temperatures that 10, "
        "50 and 90 % of the tumour exceed; the fraction of it above 43 °C; doses so "
        "far."
    )
    return titled_picture("protocol", run.title, lambda: _protocol(run, bound), caption)


def _protocol(run: HeatedRun, bound: float | None) -> Figure:
    """Panels below each other on one axis of time."""
    names = {"hottest": "hottest cell"}
    temperatures = {names.get(n, n): curve for n, curve in run.temperatures.items()}
    names = {"D90": "D90 of the tumour", "outside": "largest outside it"}
    doses = {names[name]: curve for name, curve in run.doses.items()}
    fractions = {"V43, of the tumour above 43 °C": run.above}
    figure = new_figure(5.0, 7.5)
    panels = figure.subplots(4, 1, sharex=True)
    for ax in panels:
        prepare_axes(ax)
    above, middle, share_axes, below = panels
    field = run.protocol
    at = np.repeat(np.asarray(field.edges) / 60, 2)[1:-1]
    values = np.stack([field.starts, field.ends], axis=1).reshape(-1)
    above.plot(at, values / 1e3, color=FIELD, lw=THIN)
    above.set_ylim(bottom=0.0)
    label_axes(above, "", "amplitude H [kA/m]")
    for index, (name, curve) in enumerate(temperatures.items()):
        color = style_of(name, index).color
        middle.plot(run.times / 60, curve, color=color, lw=THIN, label=name)
    if bound is not None:
        middle.axhline(bound, color=GREY, lw=0.8, ls=(0, (4, 2)))
    label_axes(middle, "", "temperature [°C]")
    for color, (name, curve) in zip(SPARE, fractions.items(), strict=False):
        share_axes.plot(run.times / 60, curve, color=color, lw=THIN, label=name)
    share_axes.set_ylim(-0.05, 1.05)
    label_axes(share_axes, "", "fraction")
    for index, (name, curve) in enumerate(doses.items()):
        shown = np.where(curve > 1e-3, curve, np.nan)
        color = style_of(name, index).color
        below.plot(run.times / 60, shown, color=color, lw=THIN, label=name)
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
