"""The choice of models on the nine sessions: docs/figures/choice.png.

Run with python docs/figures/draw_choice.py FOLDER docs/figures/choice.png, FOLDER being
that of the recordings (PINAV_RECORDINGS). Each session is split at 30, 50 and 70 % of
its time; each point is the median error over 10 s of one split, of the chosen model
against least squares. The numbers are printed, as docs/identification.md states them.
"""

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from pinav.figures.palette import BLACK, BLUE, GREY, VERMILLION
from pinav.figures.style import (
    THIN,
    add_legend,
    label_axes,
    new_figure,
    prepare_axes,
)
from pinav.identification import (
    FrameJitter,
    Rollouts,
    Track,
    coverage,
    path_of,
    select_model,
    tracks,
)
from pinav.recordings import read_recording

SESSIONS = "magscope_cellbot_sessions/sessions.csv.gz"
SPLITS = (0.3, 0.5, 0.7)
HORIZON = 10.0


class Split(NamedTuple):
    """Median errors over the path on the held-out part, and what its bands hold."""

    chosen: float
    least_squares: float
    inside: float
    rollouts: int


def judge(track: Track, fraction: float) -> Split:
    """The model that the first part of a track chooses, on the rest."""
    selection = select_model(track, train_fraction=fraction)
    rows = (selection.row(name) for name in (selection.chosen, "least squares"))
    chosen, baseline = (row.errors[HORIZON].relative for row in rows)
    jitter = FrameJitter.of(selection.train, path_of(selection.best))
    rollouts = Rollouts.of(selection.held_out, HORIZON)
    bands = coverage(selection.held_out, rollouts, selection.best, jitter)
    return Split(chosen, baseline, bands.inside, bands.rollouts)


def summary(half: str, splits: list[Split]) -> str:
    """A line of the table."""
    chosen, baseline, inside, counts = map(np.array, zip(*splits, strict=True))
    return (
        f"{half}: {len(splits)} splits, {counts.sum()} rollouts, median "
        f"{np.median(chosen):.3f}, least squares {np.median(baseline):.3f}, "
        f"{(chosen > 1.1 * baseline).sum()} worse by 10 %, bands of 90 % hold "
        f"{100 * (inside * counts).sum() / counts.sum():.0f} %"
    )


def draw(halves: dict[str, list[Split]], ax: Axes) -> None:
    """The chosen model against least squares; below the line it is better."""
    prepare_axes(ax)
    looks = {"development": (GREY, "o"), "judged": (BLUE, "s")}
    for half, splits in halves.items():
        chosen, baseline, *_ = zip(*splits, strict=True)
        color, marker = looks[half]
        ax.plot(baseline, chosen, marker, color=color, ms=5, label=half)
    ends = np.array([0.01, 0.6])
    ax.plot(ends, ends, color=BLACK, lw=THIN, label="as least squares")
    ax.plot(ends, 0.8 * ends, "--", color=VERMILLION, lw=THIN, label="0.8 of it")
    ax.set(xscale="log", yscale="log", xlim=ends, ylim=ends)
    label_axes(ax, "least squares: error / path, 10 s", "chosen model")
    ax.tick_params(which="minor", labelsize=0)
    add_legend(ax)


def main(folder: str, out: str) -> None:
    """Judge all splits, print the table and draw it."""
    several = sorted(tracks(read_recording(Path(folder) / SESSIONS)), key=_name)
    halves: dict[str, list[Split]] = {"development": [], "judged": []}
    for place, track in enumerate(several):
        half = "judged" if place % 2 else "development"
        for fraction in SPLITS:
            halves[half].append(judge(track, fraction))
            print(half, track.name, fraction, halves[half][-1], flush=True)
    for half, splits in halves.items():
        print(summary(half, splits))
    figure = new_figure(4.2, 3.6)
    draw(halves, figure.subplots())
    figure.savefig(out, dpi=150, metadata={"Software": None})


def _name(track: Track) -> str:
    return track.name


if __name__ == "__main__":
    main(*sys.argv[1:])
