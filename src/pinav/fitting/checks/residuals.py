"""Faults of single rows and of whole tracks that a fit of noise hides."""

from typing import Any

import numpy as np
from jaxtyping import Float

from pinav.fitting.checks.departures import Contradiction
from pinav.trajectories import Trajectories

OUTLIER = "outlier"
"""Name of a departure of one position."""

ALIKE = 0.1
"""Difference of two tracks, in units of the noise, below which one copies the other:
that of two films of one path is 1.4."""


def weigh_outlier(
    states: Float[np.ndarray, "trajectory time state"], data: Trajectories
) -> Contradiction:
    r"""Evidence that the position farthest from the fit has an error of its own.

    Without one of n residuals of unknown noise the others have $1 - s$ of the sum of
    squares, so that the logarithm of the likelihood grows by $-n/2 \log(1 - s)$; that
    it may be any of n costs $\log n$.
    """
    residuals = np.where(data.observed, data.states - states, 0.0)
    squares, count = residuals**2, int(data.observed.sum())
    total = max(float(squares.sum()), np.finfo(float).tiny)
    track, row, channel = np.unravel_index(int(squares.argmax()), squares.shape)
    fraction = min(float(squares[track, row, channel]) / total, 1.0 - 1e-12)
    gain = -0.5 * count * np.log1p(-fraction) - np.log(count)
    others = np.sqrt(total * (1.0 - fraction) / max(count - 1, 1))
    size = abs(float(residuals[track, row, channel])) / max(others, 1e-300)
    return Contradiction(
        OUTLIER,
        float(gain),
        f"{data.channels[channel]} of trajectory {track} in row {row} lies "
        f"{size:.0f} standard deviations of the others from the fit",
    )


def copied_tracks(data: Trajectories, noise: float) -> tuple[int, int] | None:
    """The first two tracks of which one copies the other; None where none does."""
    pieces: list[Any] = list(data)
    for later, one in enumerate(pieces):
        for earlier, other in enumerate(pieces[:later]):
            if one.states.shape != other.states.shape:
                continue
            both = one.observed & other.observed
            change = (one.states - other.states)[both]
            if len(change) > 1 and np.sqrt(np.mean(change**2)) < ALIKE * noise:
                return earlier, later
    return None
