"""Rankings of models: candidate laws of a learned force, and models by evidence."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pinav.analysis import Discovery
from pinav.evaluation import normal_quantile
from pinav.figures.images import Picture
from pinav.figures.palette import (
    BLUE,
    GREY,
    ORANGE,
    VERMILLION,
)
from pinav.figures.style import (
    SMALL,
    add_legend,
    label_axes,
    new_figure,
    prepare_axes,
    title_panel,
    with_unit,
)
from pinav.units import force_unit

CLOSE, FLOOR = 6.0, 0.5
"""Difference up to which laws are not told apart, and the shortest bar."""


def law_ranking(found: Discovery, *, ax: Axes | None = None) -> Axes:
    """Bars of the difference in BIC to the best law, on a logarithmic scale.

    Laws that are not told apart from the best one are blue, the others grey; those
    whose refit diverged are left out.

    Args:
        found: the laws.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    close = [law.name for law in found.close]
    shown = [
        (law.name, max(law.delta_bic, FLOOR), BLUE if law.name in close else GREY)
        for law in found.candidates
        if np.isfinite(law.delta_bic)
    ]
    labels, lengths = [n for n, _, _ in shown], [d for _, d, _ in shown]
    colors = [color for _, _, color in shown]
    ax.barh(labels, [n - 0.9 * FLOOR for n in lengths], 0.6, 0.9 * FLOOR, color=colors)
    ax.axvline(CLOSE, color=VERMILLION, lw=0.8, ls="--")
    ax.set_xscale("log")
    ax.set_xlim(0.9 * FLOOR, 2.0 * max(*lengths, 2 * CLOSE))
    ax.invert_yaxis()
    label_axes(ax, r"$\Delta$BIC (dashed: 6)", "")
    ax.tick_params(axis="y", length=0)
    return ax


def law_agreement(found: Discovery, *, ax: Axes | None = None) -> Axes:
    """The learned force against that of the best law, both components.

    Args:
        found: the laws, with the force at points in visited regions; bars are 95 %
            intervals.
        ax: where to draw; a new figure unless given.
    """
    learned, sd, law = found.sample.force, found.sample.sd, found.best_force
    unit = force_unit(found.units)
    ax = prepare_axes(ax)
    for column, (label, color) in enumerate((("$F_x$", BLUE), ("$F_y$", ORANGE))):
        ax.errorbar(
            law[:, column],
            learned[:, column],
            normal_quantile() * sd[:, column],
            fmt="o",
            ms=2.5,
            lw=0.6,
            color=color,
            label=label,
        )
    span = (min(law.min(), learned.min()), max(law.max(), learned.max()))
    ax.plot(span, span, "-", color=GREY, lw=0.8, zorder=0)
    label_axes(ax, with_unit("force of the law", unit), with_unit("learned", unit))
    add_legend(ax, loc="upper left")
    return ax


def law_figure(found: Discovery) -> Picture:
    """Ranking of the laws beside the best one's agreement with the learned force."""

    def draw() -> Figure:
        figure = new_figure(7.5, 3.0)
        left, right = figure.subplots(1, 2)
        law_ranking(found, ax=left)
        law_agreement(found, ax=right)
        title_panel(left, "(a) candidate laws")
        title_panel(right, f"(b) {found.best.name} in visited regions")
        left.tick_params(axis="y", labelsize=SMALL)
        return figure

    return Picture(
        "laws",
        draw,
        "(a) Difference in BIC of laws refitted to the trajectories; laws in blue are "
        "not told apart, those in grey are, or extend the best one. (b) The best law "
        "and the learned force at points in visited regions, bars 95 %.",
        "Ranking of candidate laws, and the best one against the learned force",
    )


def formula_figure(formula: str, name: str, law: str) -> Picture | None:
    """A formula, drawn; none where matplotlib cannot draw it.

    Args:
        formula: in LaTeX.
        name: of the files, without ending.
        law: name of the law.
    """
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
