"""Figures of the tutorials, from runs that follow them word for word."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from docs.figures.methods import WIDTH, maps_of, observed_paths
from docs.figures.workshop import Workshop
from matplotlib.figure import Figure

from pinav.figures import force_comparison
from pinav.figures.analysis import one_legend
from pinav.figures.force_maps import force_error_map, force_map
from pinav.figures.style import new_figure, title_panel


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
    force_map(true, path=path, limit=limit, shade=False, ax=axes[0])
    force_map(learned, path=path, limit=limit, ax=axes[1])
    for ax, model in zip(axes[2:], (learned, other), strict=True):
        force_error_map(model, true, limit=limit / 2, ax=ax)
    titles = ("true", "network with time", "its error", "error of kernels")
    for ax, letter, title in zip(axes, "abcd", titles, strict=True):
        title_panel(ax, f"({letter}) {title}")
    one_legend(figure, axes[::-1])
    return figure
