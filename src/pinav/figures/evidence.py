"""The evidence of several models, as bars."""

from collections.abc import Mapping

from matplotlib.figure import Figure

from pinav.figures.palette import (
    BLUE,
)
from pinav.figures.style import label_axes, new_figure, prepare_axes


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
