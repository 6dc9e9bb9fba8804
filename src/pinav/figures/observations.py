"""What was observed beside what a model makes of it, all trajectories together."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from pinav.figures.palette import (
    BLACK,
    LEARNED,
    PAPER,
    TRACK,
)
from pinav.figures.style import (
    DIMENSIONLESS,
    THIN,
    add_legend,
    label_axes,
    label_plane,
    prepare_axes,
)


def observed_paths(
    observed: Sequence[Float[np.ndarray, "_ 2"]],
    predicted: Sequence[Float[np.ndarray, "_ 2"]],
    *,
    units: Mapping[str, str] = DIMENSIONLESS,
    ax: Axes | None = None,
) -> Axes:
    """Observed positions as dots, rollouts of the model as lines, starts marked.

    Args:
        observed: positions of each trajectory [L]; NaN where not observed.
        predicted: positions of its rollout [L].
        units: unit of each channel; "1" means dimensionless.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    dots = {"color": TRACK, "markersize": 2.0, "label": "observed"}
    line = {"color": LEARNED, "lw": THIN, "label": "model"}
    for measured, path in zip(observed, predicted, strict=True):
        ax.plot(*measured.T, ".", **dots)
        ax.plot(*path.T, **line)
        dots["label"] = line["label"] = "_"
    starts = np.array([path[0] for path in predicted])
    ax.plot(*starts.T, "o", mfc=PAPER, mec=BLACK, markersize=4, label="start")
    low, high = _limits(observed)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    label_plane(ax, units, adjustable="box")
    add_legend(ax)
    return ax


def positions_over_time(
    times: Sequence[Float[np.ndarray, " time"]],
    observed: Sequence[Float[np.ndarray, " time"]],
    predicted: Sequence[Float[np.ndarray, " time"]],
    *,
    labels: tuple[str, str],
    ax: Axes | None = None,
) -> Axes:
    """Observed positions on a line as dots, rollouts of the model as lines.

    Args:
        times: of each trajectory [T].
        observed: positions [L]; NaN where not observed.
        predicted: positions of its rollout [L].
        labels: of the axes.
        ax: where to draw; a new figure unless given.
    """
    ax = prepare_axes(ax)
    for ts, measured, path in zip(times, observed, predicted, strict=True):
        ax.plot(ts, measured, ".", color=TRACK, markersize=1.5)
        ax.plot(ts, path, color=LEARNED, lw=0.8)
    label_axes(ax, *labels)
    return ax


def _limits(observed: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """A frame about the observed positions, with a margin of a twentieth."""
    points = np.concatenate(observed)
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    margin = 0.05 * max(float(np.max(high - low)), 1e-300)
    return low - margin, high + margin
