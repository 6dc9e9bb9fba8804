"""Candidate laws of a learned force: their ranking, and the best one against it."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pinav.evaluation import normal_quantile
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

CLOSE, FLOOR = 6.0, 0.5
"""Difference up to which laws are not told apart, and the shortest bar."""


def law_ranking(
    names: Sequence[str],
    differences: Sequence[float],
    close: Sequence[bool],
    *,
    ax: Axes | None = None,
) -> Axes:
    """Bars of the difference in BIC to the best law, on a logarithmic scale.

    Args:
        names: of the laws, the best one first.
        differences: of their BIC to that of the best one; what is not finite is left
            out.
        close: whether each one is not told apart from the best one: blue, else grey.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    shown = [
        (name, max(difference, FLOOR), BLUE if is_close else GREY)
        for name, difference, is_close in zip(names, differences, close, strict=True)
        if np.isfinite(difference)
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


def law_agreement(
    learned: Float[np.ndarray, "point 2"],
    sd: Float[np.ndarray, "point 2"],
    law: Float[np.ndarray, "point 2"],
    *,
    unit: str = "1",
    ax: Axes | None = None,
) -> Axes:
    """The learned force against that of a law, both components, at the same points.

    Args:
        learned: force at points in visited regions.
        sd: its standard deviation; bars are 95 % intervals.
        law: force of the law there.
        unit: of a force; "1" means dimensionless.
        ax: where to draw; a new figure unless given.
    """
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


def law_figure(
    names: Sequence[str],
    differences: Sequence[float],
    close: Sequence[bool],
    learned: Float[np.ndarray, "point 2"],
    sd: Float[np.ndarray, "point 2"],
    law: Float[np.ndarray, "point 2"],
    *,
    unit: str = "1",
) -> Figure:
    """Ranking of the laws beside the best one's agreement with the learned force.

    Args:
        names: as for `law_ranking`.
        differences: as for `law_ranking`.
        close: as for `law_ranking`.
        learned: as for `law_agreement`.
        sd: as for `law_agreement`.
        law: as for `law_agreement`.
        unit: as for `law_agreement`.
    """
    figure = new_figure(7.5, 3.0)
    left, right = figure.subplots(1, 2)
    law_ranking(names, differences, close, ax=left)
    law_agreement(learned, sd, law, unit=unit, ax=right)
    title_panel(left, "(a) candidate laws")
    title_panel(right, f"(b) {names[0]} in visited regions")
    left.tick_params(axis="y", labelsize=SMALL)
    return figure


def formula_figure(formula: str) -> Figure | None:
    """A formula, drawn; none where matplotlib cannot draw it.

    Args:
        formula: in LaTeX.
    """
    if not formula or "matrix" in formula:
        return None
    figure = new_figure(6.5, 0.5)
    figure.text(0.5, 0.5, f"${formula}$", fontsize=11, ha="center", va="center")
    return figure
