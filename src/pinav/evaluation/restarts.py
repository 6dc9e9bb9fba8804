"""Errors of rollouts that start anew at observed positions, by their length.

One rollout of a whole film adds up all that wanders: its error says how long the film
is. Rollouts of seconds say what a model predicts.
"""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.dynamics import AbstractDynamics
from pinav.evaluation.scores import predict
from pinav.trajectories import Trajectories, Trajectory

LENGTHS = (1.0, 5.0, 10.0)
"""Lengths of the rollouts [T]."""

ROLLOUTS = 60
"""Rollouts at most, evenly spread over the data."""


class RestartErrors(eqx.Module):
    """End-point errors of rollouts from observed positions.

    Attributes:
        lengths: of the rollouts [T].
        errors: median distance between predicted and observed end [L].
        rollouts: their number.
    """

    lengths: Float[np.ndarray, " length"]
    errors: Float[np.ndarray, " length"]
    rollouts: int


def restart_errors(
    dynamics: AbstractDynamics, data: Trajectories
) -> RestartErrors | None:
    """Errors of a first-order model over windows of the data, one after the other.

    Args:
        dynamics: the model; its state are the positions.
        data: positions, and the commands that drive the model where it takes any.

    Returns:
        The errors; None where no trajectory is as long as the longest rollout.
    """
    windows = [
        (source, window)
        for source, piece in enumerate(data)
        for window in _windows(piece)
    ]
    if not windows:
        return None
    count = min(len(windows), ROLLOUTS)
    chosen = [windows[i] for i in np.linspace(0, len(windows) - 1, count).astype(int)]
    sources, pieces = zip(*chosen, strict=True)
    parts = Trajectories.from_pieces(pieces, data.channels, data.units, data.provenance)
    paths, _ = predict(dynamics, parts, driven_by=data.select(sources))
    distances = np.full((count, len(LENGTHS)), np.nan)
    for row, (piece, path) in enumerate(zip(pieces, paths, strict=True)):
        ends = np.searchsorted(piece.times, piece.times[0] + np.array(LENGTHS) - 1e-9)
        miss = path[ends] - piece.states[ends]
        distances[row] = np.linalg.norm(miss[:, : data.dim], axis=1)
    return RestartErrors(np.array(LENGTHS), np.median(distances, axis=0), count)


def _windows(piece: Trajectory) -> list[Trajectory]:
    """Parts of the longest length, without the samples that were not observed."""
    seen = np.flatnonzero(piece.observed.all(axis=1))
    times, parts, first = piece.times[seen], [], 0
    while first < len(seen):
        last = int(np.searchsorted(times, times[first] + LENGTHS[-1] - 1e-9))
        if last >= len(seen):
            break
        rows = seen[first : last + 1]
        commands = {name: values[rows] for name, values in piece.commands.items()}
        parts.append(
            Trajectory(
                times=piece.times[rows],
                states=piece.states[rows],
                observed=piece.observed[rows],
                commands=commands,
            )
        )
        first = last
    return parts
