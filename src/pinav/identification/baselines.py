"""Plain regressions on a track: gain and drift, or a restoring force."""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from pinav.errors import InputError
from pinav.identification.forecast import Displacement, integrate_held
from pinav.identification.tracks import Track, commands_of
from pinav.recordings.drive import command_vector
from pinav.trajectories import Trajectory

WINDOW = 1.0
"""Velocities are central differences over this time [s]."""


def least_squares(track: Track) -> Displacement:
    """Gain matrix and drift by least squares of the velocity: no delay, no noise.

    Returns:
        The fitted velocity, held from sample to sample, integrated.
    """
    parts = [(piece, *velocities(track, piece)) for piece in track.pieces]
    design = np.concatenate([_regressors(piece)[rows] for piece, _, rows in parts])
    targets = np.concatenate([values for _, values, _ in parts])
    best = np.linalg.lstsq(design, targets, rcond=None)[0]
    return lambda piece: integrate_held(_regressors(piece) @ best, piece.times)


def velocities(
    track: Track, piece: Trajectory
) -> tuple[Float[np.ndarray, "row 2"], Bool[np.ndarray, " time"]]:
    """Velocities [L T⁻¹] of a segment where a window lies within it, and a mask."""
    times, window = piece.times, min(WINDOW, 2 * track.width)
    low = np.searchsorted(times, times - window / 2)
    high = np.searchsorted(times, times + window / 2, side="right") - 1
    inner = (times - times[0] >= window / 2) & (times[-1] - times >= window / 2)
    inner &= high > low
    low, high = low[inner], high[inner]
    interval = (times[high] - times[low])[:, None]
    return (piece.states[high] - piece.states[low]) / interval, inner


def _regressors(piece: Trajectory) -> Float[np.ndarray, "time 3"]:
    """The command [Hz], and one."""
    command = command_vector(*commands_of(piece))
    return np.concatenate([command, np.ones((len(command), 1))], axis=1)


INTERVAL = 0.5
"""Time between the positions that are compared [s], as long as a block."""

HORIZON = 10.0
"""Time over which displacements are predicted [s]."""

LEAST_STEPS = 30
"""Displacements without which nothing is sought."""


class RestoringForce(eqx.Module):
    r"""A linear force on an undriven track.

    Positions every 0.5 s follow
    $x_{i+1} - x_i = a + \Phi (x_i - x_{i-1}) + B x_i + \epsilon$, in which $\Phi$ is
    what a wandering velocity does, whatever its memory, and $B$ a linear force:
    $B = e^{-K \tau} - 1$ for the rates $K$ and the interval $\tau$ where $\Phi$ is 0.
    Both are fitted together, so that neither takes what belongs to the other.

    Attributes:
        pull: matrix $B$: the displacement in an interval for each unit of position.
        memory: matrix $\Phi$, which multiplies the previous displacement.
        offset: vector $a$ [L].
        nats: log evidence relative to $B = 0$, by the Bayesian information criterion.
        explained: share of the variance of held-out displacements over 10 s; NaN where
            there are none.
    """

    pull: Float[np.ndarray, "2 2"]
    memory: Float[np.ndarray, "2 2"]
    offset: Float[np.ndarray, "2"]
    nats: float
    explained: float

    @property
    def rates(self) -> Float[np.ndarray, "2"]:
        """Rates at which the two principal displacements decay [1/T]."""
        left = np.abs(np.linalg.eigvals(np.eye(2) + self.pull))
        return np.sort(-np.log(np.clip(left, 1e-12, None)) / INTERVAL)

    @property
    def centre(self) -> Float[np.ndarray, "2"]:
        """Place where nothing pulls [L]."""
        return -np.linalg.lstsq(self.pull, self.offset)[0]

    def sentence(self, decisive: float) -> str:
        """The finding in words; it is supported from so many nats on."""
        if self.nats < decisive:
            return f"A force that pulls back: not supported ({self.nats:+.1f} nats)."
        low, high = self.rates
        x, y = self.centre
        text = (
            f"A force that pulls back to ({x:.3g}, {y:.3g}): supported, by "
            f"{self.nats:.1f} nats, with rates of {low:.2g} and {high:.2g} per unit of "
            "time"
        )
        if np.isfinite(self.explained):
            text += (
                f"; it explains {100 * self.explained:.0f} % of the variance of "
                f"held-out displacements over {HORIZON:g} s"
            )
        return text + "."


def restoring_force(train: Track, held_out: Track) -> RestoringForce:
    """Fit a linear force beside a wandering velocity, and judge it on held-out data.

    Raises:
        InputError: the training part is too short.
    """
    positions = [_resample(piece.times, piece.states) for piece in train.pieces]
    rows = [_rows(path) for path in positions if len(path) > 2]
    if sum(len(steps) for steps, _ in rows) < LEAST_STEPS:
        raise InputError(
            f"track {train.name}: expected {LEAST_STEPS} displacements of {INTERVAL:g} "
            "s or more; a force is not sought"
        )
    steps, columns = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    weights, full = _regress(columns, steps)
    _, without = _regress(columns[:, :3], steps)
    count = len(steps)
    gain = 0.5 * count * (np.linalg.slogdet(without)[1] - np.linalg.slogdet(full)[1])
    offset, memory, pull = weights[0], weights[1:3].T, weights[3:].T
    return RestoringForce(
        pull=pull,
        memory=memory,
        offset=offset,
        nats=float(gain - 0.5 * 4 * np.log(count)),
        explained=_share_of_variance(offset, memory, pull, held_out),
    )


def _resample(times: np.ndarray, states: np.ndarray) -> Float[np.ndarray, "time 2"]:
    at = np.arange(times[0], times[-1], INTERVAL)
    return np.stack([np.interp(at, times, column) for column in states.T], axis=1)


def _rows(path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    steps = np.diff(path, axis=0)
    one = np.ones((len(steps) - 1, 1))
    return steps[1:], np.concatenate([one, steps[:-1], path[1:-1]], axis=1)


def _regress(columns: np.ndarray, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights, and the covariance of what they leave."""
    weights = np.linalg.lstsq(columns, steps)[0]
    left = steps - columns @ weights
    return weights, left.T @ left / len(steps)


def _share_of_variance(
    offset: np.ndarray, memory: np.ndarray, pull: np.ndarray, held_out: Track
) -> float:
    """Share of the variance of displacements over the horizon, from rollouts."""
    ahead = round(HORIZON / INTERVAL)
    displacements, predicted = [], []
    for piece in held_out.pieces:
        path = _resample(piece.times, piece.states)
        for start in range(1, len(path) - ahead):
            before, here = path[start - 1], path[start]
            for _ in range(ahead):
                step = offset + memory @ (here - before) + pull @ here
                before, here = here, here + step
            displacements.append(path[start + ahead] - path[start])
            predicted.append(here - path[start])
    return explained_variance(np.array(displacements), np.array(predicted))


def explained_variance(observed: np.ndarray, predicted: np.ndarray) -> float:
    """Explained share of the variance of all columns; NaN for fewer than two rows."""
    if len(observed) < 2:
        return float("nan")
    spread = ((observed - observed.mean(axis=0)) ** 2).sum()
    return float(1 - ((observed - predicted) ** 2).sum() / max(spread, 1e-30))
