"""Figures of errors: over time, by region, over data or noise, and of residuals."""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pinav.evaluation import ErrorCurve, Evaluation, Whiteness, normal_quantile
from pinav.figures.images import Picture
from pinav.figures.palette import GREY, SHADE
from pinav.figures.style import (
    SPARE,
    THIN,
    LineStyle,
    band,
    draw_panels,
    finite,
    label_axes,
    mark_line,
    prepare_axes,
    scale_log,
    style_of,
    with_unit,
)

MARKERS = "os^vDxP"


def error_over_time(
    curves: Mapping[str, ErrorCurve],
    *,
    styles: Mapping[str, LineStyle] | None = None,
    horizon: float | None = None,
    unit: str = "1",
    ax: Axes | None = None,
) -> Axes:
    """Median position error over time, with the 90th percentile above it.

    What diverged leaves the frame: a line ends where half, or a tenth, of the
    trajectories have diverged.

    Args:
        curves: by the name of the legend.
        styles: how each is drawn; as everywhere (`style_of`) unless given.
        horizon: longest time in the training data [T], marked unless None.
        unit: of length; "1" means dimensionless.
    """
    ax = prepare_axes(ax)
    for index, (name, curve) in enumerate(curves.items()):
        style = (styles or {}).get(name) or style_of(name, index)
        color, dash = style.color, style.dash
        median, high = _positive(curve.median), _positive(curve.high)
        drawn = {"color": color, "line": dash, "width": THIN, "alpha": 0.15}
        band(curve.elapsed, median, (median, high), name=name, **drawn, ax=ax)
        ax.plot(curve.elapsed, high, ":", color=color, lw=0.8)
    scale_log(ax, *(curve.high for curve in curves.values()))
    mark_line(ax, *([] if horizon is None else [horizon]))
    label = with_unit("position error", unit)
    return label_axes(ax, "time since the start", label, legend=1)


def _positive(values: np.ndarray) -> np.ndarray:
    values = finite(values)
    return np.where(values > 0, values, np.nan)


def evaluation_errors_figure(evaluation: Evaluation, error_name: str) -> Picture:
    """Errors of rollouts over time, one panel for each source of starts.

    `error_name` names the errors on the data that were given.
    """
    sources = list(next(iter(evaluation.curves.values())))
    shown = {"horizon": evaluation.horizon, "unit": evaluation.units.get("x", "")}
    panels = {}
    for source in sources:
        words = f"the data ({error_name})" if source == "data" else source
        curves = {name: each[source] for name, each in evaluation.curves.items()}
        draw = partial(error_over_time, curves, **shown)
        panels[f"rollouts from {words}"] = draw
    return Picture(
        "evaluation-errors",
        partial(draw_panels, (7.5 if len(sources) > 1 else 4.4, 3.2), panels),
        "Position error over time since the start: median (line) and 90th percentile "
        "(dotted) over trajectories; a line ends where that fraction has diverged. "
        "Dashed: the training horizon.",
    )


def residuals_figure(test: Whiteness) -> Picture:
    """Autocorrelation of the residuals of a fit."""
    panels = [partial(residual_autocorrelation, test)]
    return Picture(
        "evaluation-residuals",
        partial(draw_panels, (4.4, 3.2), panels),
        "Autocorrelation of the residuals on the training data; grey: what 95 % of "
        "white residuals would show.",
        width=0.6,
    )


def residual_autocorrelation(test: Whiteness, *, ax: Axes | None = None) -> Axes:
    r"""Autocorrelation at each lag, with the 95 % band of white noise.

    A channel without residuals is left out.
    """
    autocorrelation, counts = test.autocorrelation, test.counts
    ax = prepare_axes(ax)
    lags = np.arange(1, autocorrelation.shape[1] + 1)
    used = [i for i, count in enumerate(counts) if count]
    for place, i in enumerate(used):
        at = lags + 0.12 * (place - (len(used) - 1) / 2)
        values, color = finite(autocorrelation[i]), SPARE[i % len(SPARE)]
        ax.vlines(at, 0.0, values, color=color, lw=THIN)
        name = test.channels[i]
        ax.plot(at, values, MARKERS[i % len(MARKERS)], color=color, ms=3.5, label=name)
    bound = normal_quantile() / np.sqrt(min(counts[i] for i in used))
    ax.axhspan(-bound, bound, color=SHADE, zorder=0, label="95 % of white noise")
    ax.axhline(0.0, color=GREY, lw=0.6)
    return label_axes(ax, "lag [samples]", "autocorrelation of residuals", legend=2)


Series = Mapping[str, Sequence[tuple[float, float]]]
"""Points (x, y) by model; several at one x are several seeds."""


def scaling_figure(force: Series, rollouts: Series, *, quantity: str) -> Figure:
    """Force error and rollout error over the size or the noise of the data, log-log.

    A zero on the x axis stands left of all others, and is labelled so.

    Args:
        force: relative force error in visited regions.
        rollouts: median position error of held-out rollouts.
        quantity: label of the x axis.
    """
    percent = {m: [(x, 100 * y) for x, y in points] for m, points in force.items()}
    left = quantity, "force error in visited regions (%)"
    right = quantity, "held-out median position error"
    panels = {
        "(a) force": partial(_scaling, percent, left),
        "(b) rollouts from held-out starts": partial(
            _scaling, rollouts, right, legend=1
        ),
    }
    return draw_panels((7.5, 3.6), panels)


def _scaling(
    series: Series, labels: tuple[str, str], *, legend: int = 0, ax: Axes
) -> None:
    ticks = sorted({x for points in series.values() for x, _ in points})
    least = min((x for x in ticks if x > 0), default=1.0)
    place = {x: x if x > 0 else least / 2 for x in ticks}
    for index, (name, points) in enumerate(series.items()):
        style, marker = style_of(name, index), MARKERS[index % len(MARKERS)]
        shown = [(place[x], y) for x, y in points if np.isfinite(y) and y > 0]
        if not shown:
            ax.plot([], [], style.dash, color=style.color, label=f"{style.label}: none")
            continue
        at = sorted({x for x, _ in shown})
        middle = [np.median([y for other, y in shown if other == x]) for x in at]
        ax.plot(at, middle, style.dash, color=style.color, lw=THIN, label=style.label)
        ax.plot(*zip(*shown, strict=True), marker, color=style.color, ms=4)
    ax.set_xscale("log")
    scale_log(ax, *([y for _, y in points] for points in series.values()))
    ax.minorticks_off()
    ax.set_xticks([place[x] for x in ticks], [f"{x:g}" for x in ticks])
    label_axes(ax, *labels, legend=legend)
