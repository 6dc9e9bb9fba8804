"""Least squares of the velocity, the baseline of every recording."""

import time
from collections.abc import Callable

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.identification.forecast import Displacement
from pinav.identification.tracks import Track, commands_of
from pinav.trajectories import Trajectory

WINDOW = 1.0
"""Velocities are central differences over this time [s]."""


class Baseline(eqx.Module):
    """A fitted baseline.

    Attributes:
        name: name in tables.
        velocity: velocity at each sample of a segment [L T⁻¹].
        seconds: duration of the fit [s].
    """

    name: str = eqx.field(static=True)
    velocity: Callable[[Trajectory], Float[np.ndarray, "time 2"]]
    seconds: float

    def displacement(self) -> Displacement:
        """Its velocity, held from sample to sample, integrated."""

        def path(piece: Trajectory) -> Float[np.ndarray, "time 2"]:
            steps = self.velocity(piece)[:-1] * np.diff(piece.times)[:, None]
            return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])

        return path


class Samples(eqx.Module):
    """Velocities of a track beside the commands.

    Attributes:
        velocity: central differences [L T⁻¹].
        position: [L].
        frequency: [Hz].
        heading: [rad].
    """

    velocity: Float[np.ndarray, "sample 2"]
    position: Float[np.ndarray, "sample 2"]
    frequency: Float[np.ndarray, " sample"]
    heading: Float[np.ndarray, " sample"]

    @classmethod
    def of(cls, track: Track) -> "Samples":
        """All samples whose window lies within their segment."""
        parts = []
        window = min(WINDOW, 2 * track.width)
        for piece in track.pieces:
            times = piece.times
            low = np.searchsorted(times, times - window / 2)
            high = np.searchsorted(times, times + window / 2, side="right") - 1
            inner = (times - times[0] >= window / 2) & (times[-1] - times >= window / 2)
            inner &= high > low
            low, high = low[inner], high[inner]
            interval = (times[high] - times[low])[:, None]
            velocity = (piece.states[high] - piece.states[low]) / interval
            frequency, heading = commands_of(piece)
            parts.append(
                (velocity, piece.states[inner], frequency[inner], heading[inner])
            )
        return cls(*map(np.concatenate, zip(*parts, strict=True)))

    def command(self) -> Float[np.ndarray, "sample 2"]:
        r"""$f\,n(\theta)$ [Hz]."""
        return command_vector(self.frequency, self.heading)


def command_vector(frequency: np.ndarray, heading: np.ndarray) -> np.ndarray:
    r"""$f\,n(\theta)$ [Hz]."""
    return frequency[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)


def least_squares(track: Track) -> Baseline:
    """Gain matrix and drift by least squares of the velocity: no delay, no noise."""
    begin = time.perf_counter()
    samples = Samples.of(track)

    def rows(command: np.ndarray) -> np.ndarray:
        return np.concatenate([command, np.ones((len(command), 1))], axis=1)

    design = rows(samples.command())
    best = np.linalg.lstsq(design, samples.velocity, rcond=None)[0]

    def velocity(piece: Trajectory) -> np.ndarray:
        return rows(command_vector(*commands_of(piece))) @ best

    return Baseline("least squares", velocity, time.perf_counter() - begin)
