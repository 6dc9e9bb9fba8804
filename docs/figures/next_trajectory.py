"""Error of the force along a route after suggested and after random trajectories."""

from functools import partial
from pathlib import Path

import numpy as np
from docs.figures.workshop import Workshop
from matplotlib.figure import Figure

from pinav.figures.palette import GREY, NEXT
from pinav.figures.style import add_legend, label_axes, new_figure, prepare_axes

DRAWS = range(100, 108)
"""Seeds; the validation, whose experiment this is, has 0 to 9."""


def write_errors(path: Path, *, seed: int, suggested: bool) -> None:
    """Errors of one draw after each trajectory."""
    # The experiment is the validation's; other figures need not import it.
    from validation.test_information import errors

    np.savetxt(path, errors(seed, suggested=suggested))


def figure(workshop: Workshop) -> Figure:
    """Thin: each draw; thick: the median over draws."""
    drawn = new_figure(4.6, 3.2)
    ax = prepare_axes(drawn.subplots())
    counts = 2 + np.arange(4)
    for name, color in (("suggested", NEXT), ("random", GREY)):
        rows = []
        for seed in DRAWS:
            write = partial(write_errors, seed=seed, suggested=name == "suggested")
            rows.append(np.loadtxt(workshop.file(f"next-{name}-{seed}.txt", write)))
        ax.plot(counts, np.transpose(rows), color=color, lw=0.7, alpha=0.5)
        median = np.median(rows, axis=0)
        ax.plot(counts, median, "o-", color=color, lw=2.4, ms=4, label=name)
        print(name, np.round(median, 2), np.round([row[-1] for row in rows], 2))
    ax.set(xticks=counts, yscale="log")
    label_axes(ax, "trajectories", "relative error of the force along the route")
    add_legend(ax)
    return drawn
