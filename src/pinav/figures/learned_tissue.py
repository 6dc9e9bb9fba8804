"""Figures of what was learned of a tissue: readings and their fit, laws, forecasts."""

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from pinav.evaluation import normal_quantile
from pinav.figures.heat import (
    ISOTHERMS,
    duration,
    figure_of,
    plane_map,
    probe_curves,
    sections_through,
    titled_picture,
)
from pinav.figures.images import Picture
from pinav.figures.palette import BLACK, LEARNED
from pinav.figures.style import (
    SMALL,
    SPARE,
    THIN,
    WIDE,
    add_legend,
    band,
    draw_panels,
    label_axes,
    mark_line,
    new_figure,
    prepare_axes,
)
from pinav.thermal.heated_run import FOLLOWED
from pinav.thermal.learned_tissue import FittedFrame, Forecast, LearnedTissue
from pinav.thermal.learning import PerfusionCurve


def curves_figure(found: LearnedTissue) -> Picture:
    """Readings of probes, or their means over each tissue, and the fit."""
    name, caption = "probes", "Readings and the fitted model."
    if found.frame is not None:
        name = "means"
        caption = (
            "Mean temperature of the voxels of each tissue that are read: dots are the "
            "readings without turns of the phase and drift, lines the fit."
        )
    curves = found.curves
    readings = curves.times, curves.read
    shown = curves.times, curves.fitted, curves.names
    draw = partial(probe_curves, *shown, readings=readings)
    return titled_picture(name, found.title, lambda: figure_of(draw()), caption)


def last_frame_figure(title: str, frame: FittedFrame) -> Picture:
    """The last frame that was fitted, the fit, and their difference."""
    caption = (
        f"The frame at {duration(frame.time)}, the last that was "
        "fitted, without turns of the phase and drift, and the fit in the same "
        "colours; reading less fit; white where no voxel is read; the tumour is "
        "outlined in blue."
    )
    return titled_picture("frame", title, lambda: _last_frame(frame), caption)


def _last_frame(frame: FittedFrame) -> Figure:
    cuts = sections_through(frame.target, frame.fitted, frame.spacing)
    name, cut = next(iter(cuts.items()))
    reading, fitted = cut.of(frame.read), cut.of(frame.fitted)
    shared = float(np.nanmin(fitted)) - 1.0, float(np.nanmax(fitted)) + 1.0
    widest = float(np.nanmax(np.abs(reading - fitted)))
    outline, spacing = cut.of(frame.target), frame.spacing[:2]
    panel = partial(
        plane_map, spacing=spacing, outline=outline, levels=()
    )  # noise has no contours
    title = name.replace(", ", ",\n")  # else into the next panel
    panels = [
        partial(panel, reading, title=title, label="reading [°C]", limits=shared),
        partial(panel, fitted, levels=ISOTHERMS, label="fit [°C]", limits=shared),
        partial(
            panel, reading - fitted, label="difference [K]", limits=(-widest, widest)
        ),
    ]
    figure = draw_panels((7.5, 2.5), panels)
    for ax in figure.axes[1:3]:
        ax.set_ylabel("")
    return figure


def forecast_figure(title: str, found: Forecast) -> Picture:
    """Predicted temperatures; below, how far they may be off, which is much less."""
    caption = (
        "Temperatures of the target, fitted up to the dashed line, predicted after it, "
        "and their 95 % bands on a scale of their own; with the truth where it is "
        "known: black above, less the prediction below."
    )
    return titled_picture("forecast", title, lambda: _forecast(found), caption)


def _forecast(found: Forecast) -> Figure:
    true = found.true
    figure = new_figure(5.0, 5.0)
    above, below = figure.subplots(2, 1, sharex=True)
    minutes = found.times / 60
    for ax in (above, below):
        mark_line(prepare_axes(ax), found.fitted_until / 60)
    for index, curve in enumerate(() if true is None else true.T):
        name = "" if index else "truth"
        above.plot(minutes, curve, color=BLACK, lw=WIDE, alpha=0.5, label=name)
    for index, name in enumerate(FOLLOWED):
        color, half = SPARE[index % len(SPARE)], normal_quantile() * found.sd[:, index]
        curve = found.values[:, index]
        above.plot(minutes, curve, color=color, lw=THIN, label=name)
        drawn = {"color": color, "alpha": 0.12, "width": 0.0}
        band(minutes, 0 * half, (-half, half), **drawn, ax=below)
        for side in (-half, half):
            below.plot(minutes, side, color=color, lw=0.6, ls=(0, (1, 1)))
        if true is not None:
            below.plot(minutes, true[:, index] - curve, color=color, lw=THIN)
    title = "(a) temperature of the target"
    label_axes(above, "", "temperature [°C]", legend=3, title=title)
    off = "95 % band" if true is None else "truth less predicted"
    title = "(b) 95 % bands about the prediction"
    label_axes(below, "time [min]", f"{off} [K]", title=title)
    return figure


MANY_TIMES = 4.0
"""Range beyond which the axis of perfusion is logarithmic; below, it had few ticks."""


def laws_figure(found: LearnedTissue) -> Picture:
    """Learned perfusion with its 95 % band; pale where the tissue was not."""
    panels = {name: partial(perfusion_law, law) for name, law in found.laws.items()}

    def draw() -> Figure:
        figure = draw_panels((3.8 * len(panels), 3.2), panels)
        add_legend(figure.axes[0])
        return figure

    caption = (
        "Perfusion over temperature with its 95 % band. Dotted: temperatures that "
        "the tissue did not reach, where the law is extrapolated. Near the "
        "arterial temperature the data do not determine perfusion."
    )
    return titled_picture("perfusion", found.title, draw, caption)


def perfusion_law(law: PerfusionCurve, *, ax: Axes | None = None) -> Axes:
    """The learned perfusion of one tissue with its band, dotted where it was not."""
    ax = prepare_axes(ax)
    temperatures, drawn = law.temperatures, {"line": ":", "width": THIN, "alpha": 0.2}
    low, high = law.band
    band(temperatures, law.values, (low, high), truth=law.true, **drawn, ax=ax)
    known = np.where(law.inside, law.values, np.nan)
    ax.plot(temperatures, known, color=LEARNED, lw=THIN, label="learned, 95 % band")
    if np.max(high) > MANY_TIMES * np.min(low):
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter(FuncFormatter(_even_tick))
    ax.tick_params(which="both", labelsize=SMALL)
    return label_axes(ax, "temperature [°C]", "perfusion [kg/(m³ s)]")


def _even_tick(value: float, _: int | None = None) -> str:
    """A tick of a logarithmic axis if it begins with 2, 4 or 6; else nothing."""
    return f"{value:g}" if f"{value:e}"[0] in "246" else ""
