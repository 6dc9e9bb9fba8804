"""Figures of the tutorials, from runs that follow them word for word."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from docs.figures.methods import WIDTH, maps_of, observed_paths
from docs.figures.workshop import Workshop
from matplotlib.figure import Figure

from pinav.figures import force_comparison
from pinav.figures.maps import ERROR, FORCE, map_panel
from pinav.figures.style import new_figure, one_legend, title_panel


def from_tutorial(name: str, run: str, figure: str) -> Callable[[Workshop], Path]:
    """The figure of a run that a tutorial makes."""
    return lambda workshop: (
        workshop.tutorial(name) / "runs" / run / "figures" / f"{figure}.png"
    )


def swimmer(workshop: Workshop) -> Figure:
    """The figure `force.png` of the run, narrower, so that it is small enough."""
    run = workshop.tutorial("swimmer") / "runs" / "my"
    maps = maps_of(run)
    figure = force_comparison(
        maps.learned, true=maps.truth, sd=maps.sd, path=observed_paths(run)
    )
    figure.set_size_inches(WIDTH, 6.4)
    figure.draw_without_rendering()  # places the panels in the new size
    return figure


def one_shot(workshop: Workshop) -> Figure:
    """The true force, that of a network with time, its error, and that of kernels."""
    runs = workshop.tutorial("wrong-force") / "runs"
    network, kernels = (maps_of(runs / name) for name in ("ude", "kernel"))
    learned, other, true = network.learned, kernels.learned, network.truth
    assert true is not None  # the truth of a scenario is known
    figure = new_figure(WIDTH, 6.2)
    axes = np.ravel(figure.subplots(2, 2))
    path = observed_paths(runs / "ude")
    limit = float(np.linalg.norm(true.force, axis=-1).max())
    shown = {"path": path, "limits": (0.0, limit)}
    map_panel(true, true.force, FORCE, shade=False, **shown, ax=axes[0])
    map_panel(learned, learned.force, FORCE, **shown, ax=axes[1])
    for ax, model in zip(axes[2:], (learned, other), strict=True):
        error, limits = model.force - true.force, (0.0, limit / 2)
        map_panel(true, error, ERROR, limits=limits, ax=ax)
    titles = ("true", "network with time", "its error", "error of kernels")
    for ax, letter, title in zip(axes, "abcd", titles, strict=True):
        title_panel(ax, f"({letter}) {title}")
    one_legend(figure, axes[::-1])
    return figure
