"""States by local polynomials: where a lifted fit starts."""

import numpy as np
from jaxtyping import Bool, Float

from pinav.errors import InputError
from pinav.trajectories.trajectories import Trajectories
from pinav.trajectories.trajectory import Trajectory

WINDOW, DEGREE = 11, 3
"""Observed samples in each local fit, and degree of its polynomial."""


def smooth_states(
    trajectories: Trajectories, dim: int | None = None
) -> Float[np.ndarray, "trajectory time state"]:
    r"""Every state by a cubic through the observed samples around it.

    On regular, complete data this is the Savitzky-Golay filter; times may be
    irregular and samples missing. In a state $y = (x, v)$ a velocity that was never
    observed is the derivative of its position. Padding repeats the last state.

    Args:
        trajectories: what was observed.
        dim: how many channels are positions; half of them unless given. The others
            are the velocities.

    Raises:
        InputError: a channel has too few observations in one trajectory, and is not
            the velocity of an observed position.

    References:
        Savitzky and Golay, Anal. Chem. 36, 1627 (1964).
    """
    dim = len(trajectories.channels) // 2 if dim is None else dim
    states = np.empty_like(trajectories.states)
    for index, piece in enumerate(trajectories):
        length = len(piece.times)
        for column in range(states.shape[2]):
            states[index, :length, column] = _channel(
                trajectories.channels, index, piece, column, dim
            )
        states[index, length:] = states[index, length - 1]
    return states


def _channel(
    channels: tuple[str, ...], index: int, piece: Trajectory, column: int, dim: int
) -> Float[np.ndarray, " time"]:
    """One channel of one trajectory: from itself, or as a derivative."""
    source, order = column, 0
    if not piece.observed[:, column].any() and column >= dim:
        source, order = column - dim, 1
    is_observed = piece.observed[:, source]
    if is_observed.sum() <= order + 1:
        raise InputError(
            f"channel {channels[column]!r} of trajectory {index}: {is_observed.sum()} "
            f"observations of {channels[source]!r} do not determine it; drop the "
            "trajectory, or observe positions"
        )
    return local_polynomial(piece.times, piece.states[:, source], is_observed, order)


def local_polynomial(
    times: Float[np.ndarray, " time"],
    values: Float[np.ndarray, " time"],
    observed: Bool[np.ndarray, " time"],
    order: int = 0,
) -> Float[np.ndarray, " time"]:
    """Value, or derivative of that `order`, of a local fit at each time.

    Args:
        times: increasing [T].
        values: what was observed; ignored where it was not.
        observed: where it was; more often than `order`.
        order: 0 for the value, 1 for the first derivative.
    """
    seen_times, seen_values = times[observed], values[observed]
    count = min(WINDOW, len(seen_times))
    middle = np.searchsorted(seen_times, times)
    first = np.clip(middle - count // 2, 0, len(seen_times) - count)
    window = first[:, None] + np.arange(count)
    offsets = seen_times[window] - times[:, None]
    scale = np.abs(offsets).max(axis=1, keepdims=True)
    powers = np.arange(min(DEGREE, count - 1) + 1)
    vandermonde = (offsets / scale)[..., None] ** powers
    coefficients = np.linalg.pinv(vandermonde) @ seen_values[window][..., None]
    return coefficients[:, order, 0] / scale[:, 0] ** order
