"""Figures of errors: over time, by region, over data or noise, and of residuals."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pinav.evaluation import ErrorCurve, Evaluation, Whiteness, normal_quantile
from pinav.figures.bands import band
from pinav.figures.images import Picture
from pinav.figures.palette import (
    GREY,
    SHADE,
)
from pinav.figures.style import (
    SMALL,
    SPARE,
    THIN,
    LineStyle,
    add_legend,
    finite,
    label_axes,
    new_figure,
    prepare_axes,
    style_of,
    title_panel,
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
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    for index, (name, curve) in enumerate(curves.items()):
        style = (styles or {}).get(name) or style_of(name, index)
        color, dash = style.color, style.dash
        median, high = _positive(curve.median), _positive(curve.high)
        drawn = {"color": color, "line": dash, "width": THIN, "alpha": 0.15}
        band(curve.elapsed, median, (median, high), name=name, **drawn, ax=ax)
        ax.plot(curve.elapsed, high, ":", color=color, lw=0.8)
    _set_log_if_positive(ax, [c.high for c in curves.values()])
    if horizon is not None:
        ax.axvline(horizon, color=GREY, lw=0.8, ls=(0, (4, 2)), zorder=1)
    label_axes(ax, "time since the start", with_unit("position error", unit))
    add_legend(ax)
    return ax


def _set_log_if_positive(ax: Axes, groups: Sequence) -> None:
    """A log scale needs one number to begin at; without any the axis stays empty."""
    values = [finite(np.asarray(group, float)) for group in groups]
    if any((group > 0).any() for group in values):
        ax.set_yscale("log")
        ax.tick_params(which="both", labelsize=SMALL)


def _positive(values: np.ndarray) -> np.ndarray:
    values = finite(values)
    return np.where(values > 0, values, np.nan)


def evaluation_errors_figure(evaluation: Evaluation, error_name: str) -> Picture:
    """Errors of rollouts over time, one panel for each source of starts.

    Args:
        evaluation: the scores.
        error_name: name of the errors on the data that were given.
    """

    def draw() -> Figure:
        sources = list(next(iter(evaluation.curves.values())))
        figure = new_figure(7.5 if len(sources) > 1 else 4.4, 3.2)
        axes = np.atleast_1d(figure.subplots(1, len(sources)))
        for ax, source in zip(axes, sources, strict=True):
            curves = {name: each[source] for name, each in evaluation.curves.items()}
            unit = evaluation.units.get("x", "")
            error_over_time(curves, horizon=evaluation.horizon, unit=unit, ax=ax)
            words = f"the data ({error_name})" if source == "data" else source
            title_panel(ax, f"rollouts from {words}")
        return figure

    return Picture(
        "evaluation-errors",
        draw,
        "Position error over time since the start: median (line) and 90th percentile "
        "(dotted) over trajectories; a line ends where that fraction has diverged. "
        "Dashed: the training horizon.",
    )


def residuals_figure(test: Whiteness) -> Picture:
    """Autocorrelation of the residuals of a fit."""

    def draw() -> Figure:
        figure = new_figure(4.4, 3.2)
        residual_autocorrelation(test, ax=figure.add_subplot())
        return figure

    return Picture(
        "evaluation-residuals",
        draw,
        "Autocorrelation of the residuals on the training data; grey: what 95 % of "
        "white residuals would show.",
        width=0.6,
    )


def residual_autocorrelation(test: Whiteness, *, ax: Axes | None = None) -> Axes:
    r"""Autocorrelation at each lag, with the 95 % band of white noise.

    Args:
        test: of the residuals; a channel without any is left out.
        ax: where to draw; a new figure unless given.
    """
    autocorrelation, counts = test.autocorrelation, test.counts
    ax = prepare_axes(ax)
    lags = np.arange(1, autocorrelation.shape[1] + 1)
    used = [i for i, count in enumerate(counts) if count]
    for place, i in enumerate(used):
        shift = 0.12 * (place - (len(used) - 1) / 2)
        values, color = finite(autocorrelation[i]), SPARE[i % len(SPARE)]
        ax.vlines(lags + shift, 0.0, values, color=color, lw=THIN)
        ax.plot(
            lags + shift,
            values,
            MARKERS[i],
            color=color,
            ms=3.5,
            label=test.channels[i],
        )
    bound = normal_quantile() / np.sqrt(min(counts[i] for i in used))
    ax.axhspan(-bound, bound, color=SHADE, zorder=0, label="95 % of white noise")
    ax.axhline(0.0, color=GREY, lw=0.6)
    label_axes(ax, "lag [samples]", "autocorrelation of residuals")
    add_legend(ax, columns=2)
    return ax


Series = Mapping[str, Sequence[tuple[float, float]]]
"""Points (x, y) by model; several at one x are several seeds."""


def scaling_figure(
    force: Series, rollouts: Series, *, quantity: str, unit: str = "1"
) -> Figure:
    """Force error and rollout error over the size or the noise of the data, log-log.

    A zero on the x axis stands left of all others, and is labelled so.

    Args:
        force: relative force error in visited regions.
        rollouts: median position error of held-out rollouts.
        quantity: label of the x axis.
        unit: of length; "1" means dimensionless.
    """
    figure = new_figure(7.5, 3.6)
    left, right = figure.subplots(1, 2)
    percent = {m: [(x, 100 * y) for x, y in points] for m, points in force.items()}
    _scaling(left, percent, quantity, "force error in visited regions (%)")
    label = with_unit("held-out median position error", unit)
    _scaling(right, rollouts, quantity, label)
    title_panel(left, "(a) force")
    title_panel(right, "(b) rollouts from held-out starts")
    add_legend(right)
    return figure


def _scaling(ax: Axes, series: Series, quantity: str, label: str) -> None:
    ax = prepare_axes(ax)
    ticks = sorted({x for points in series.values() for x, _ in points})
    place = _places(ticks)
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
    _set_log_if_positive(ax, [[y for _, y in points] for points in series.values()])
    ax.minorticks_off()
    ax.set_xticks([place[x] for x in ticks], [f"{x:g}" for x in ticks])
    label_axes(ax, quantity, label)


def _places(ticks: Sequence[float]) -> dict[float, float]:
    """Where each value stands on a log axis; zero half-way below the smallest."""
    positive = [x for x in ticks if x > 0]
    return {x: x if x > 0 else min(positive, default=1.0) / 2 for x in ticks}
