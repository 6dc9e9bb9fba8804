"""Rankings of models: candidate laws of a learned force, and models by evidence."""

from collections.abc import Mapping
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pinav.analysis import Discovery
from pinav.evaluation import normal_quantile
from pinav.figures.images import Picture
from pinav.figures.palette import BLUE, GREY, ORANGE, VERMILLION
from pinav.figures.style import (
    draw_panels,
    label_axes,
    new_figure,
    prepare_axes,
    with_unit,
)
from pinav.units import force_unit

CLOSE, FLOOR = 6.0, 0.5
"""Difference up to which laws are not told apart, and the shortest bar."""


def law_ranking(found: Discovery, *, ax: Axes | None = None) -> Axes:
    """Bars of the difference in BIC to the best law, on a logarithmic scale.

    Laws that are not told apart from the best one are blue, the others grey; those
    whose refit diverged are left out.
    """
    ax = prepare_axes(ax)
    laws = [law for law in found.candidates if np.isfinite(law.delta_bic)]
    lengths = [max(law.delta_bic, FLOOR) for law in laws]
    close = [law.name for law in found.close]
    ax.barh(
        [law.name for law in laws],
        [length - 0.9 * FLOOR for length in lengths],
        0.6,
        0.9 * FLOOR,
        color=[BLUE if law.name in close else GREY for law in laws],
    )
    ax.axvline(CLOSE, color=VERMILLION, lw=0.8, ls="--")
    ax.set_xscale("log")
    ax.set_xlim(0.9 * FLOOR, 2.0 * max(*lengths, 2 * CLOSE))
    ax.invert_yaxis()
    ax.tick_params(axis="y", length=0)
    return label_axes(ax, r"$\Delta$BIC (dashed: 6)", "")


def law_agreement(found: Discovery, *, ax: Axes | None = None) -> Axes:
    """The learned force against that of the best law, both components.

    Points are places in visited regions, bars 95 % intervals.
    """
    learned, sd, law = found.sample.force, found.sample.sd, found.best_force
    unit = force_unit(found.units)
    ax = prepare_axes(ax)
    for column, (label, color) in enumerate((("$F_x$", BLUE), ("$F_y$", ORANGE))):
        points = law[:, column], learned[:, column], normal_quantile() * sd[:, column]
        ax.errorbar(*points, fmt="o", ms=2.5, lw=0.6, color=color, label=label)
    span = (min(law.min(), learned.min()), max(law.max(), learned.max()))
    ax.plot(span, span, "-", color=GREY, lw=0.8, zorder=0)
    labels = with_unit("force of the law", unit), with_unit("learned", unit)
    return label_axes(ax, *labels, legend=1, loc="upper left")


def law_figure(found: Discovery) -> Picture:
    """Ranking of the laws beside the best one's agreement with the learned force."""
    panels = {
        "(a) candidate laws": partial(law_ranking, found),
        f"(b) {found.best.name} in visited regions": partial(law_agreement, found),
    }
    return Picture(
        "laws",
        partial(draw_panels, (7.5, 3.0), panels),
        "(a) Difference in BIC of laws refitted to the trajectories; laws in blue are "
        "not told apart, those in grey are, or extend the best one. (b) The best law "
        "and the learned force at points in visited regions, bars 95 %.",
        "Ranking of candidate laws, and the best one against the learned force",
    )


def formula_figure(formula: str, name: str, law: str) -> Picture | None:
    """The formula of a law in LaTeX, drawn; none where matplotlib cannot draw it."""
    if not formula or "matrix" in formula:
        return None

    def draw() -> Figure:
        figure = new_figure(6.5, 0.5)
        figure.text(0.5, 0.5, f"${formula}$", fontsize=11, ha="center", va="center")
        return figure

    return Picture(name, draw, f"Formula of the law: {law}.", width=0.8)


def evidence_bars(log_evidence: Mapping[str, float | None]) -> Figure:
    """By how much each model's log evidence is below the best, the best on top.

    Args:
        log_evidence: of each model [nats]; None where its fit failed.
    """
    known = {name: value for name, value in log_evidence.items() if value is not None}
    names = sorted(known, key=lambda name: known[name])
    best = max(known.values(), default=0.0)
    below = [best - known[name] for name in names]
    figure = new_figure(5.5, 0.8 + 0.35 * max(len(names), 1))
    ax = prepare_axes(figure.add_subplot())
    bars = ax.barh(names, below, color=BLUE, height=0.6)
    ax.bar_label(bars, [f"{value:.1f}" for value in below], padding=3, fontsize=8)
    ax.set_xscale("symlog", linthresh=1.0)
    ax.set_xlim(0.0, 10 * max([*below, 1.0]))
    label_axes(ax, "Δ log evidence to the best [nats]", "")
    return figure
