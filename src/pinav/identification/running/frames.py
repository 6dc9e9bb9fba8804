"""Frames of a robot, as arrays."""

import equinox as eqx
import numpy as np
from jaxtyping import Float


class Frames(eqx.Module):
    """Positions and commands, in the order of time.

    Attributes:
        times: [s].
        positions: [L]; NaN where the robot was not seen.
        frequency: applied from each time on [Hz].
        heading: likewise [rad].
    """

    times: Float[np.ndarray, " frame"]
    positions: Float[np.ndarray, "frame 2"]
    frequency: Float[np.ndarray, " frame"]
    heading: Float[np.ndarray, " frame"]

    @classmethod
    def none(cls) -> "Frames":
        """No frame."""
        return cls(np.empty(0), np.empty((0, 2)), np.empty(0), np.empty(0))

    @classmethod
    def one(
        cls,
        time: float,
        position: tuple[float, float] | None,
        frequency: float,
        heading: float,
    ) -> "Frames":
        """A single frame; no position where the robot was not seen."""
        place = (np.nan, np.nan) if position is None else position
        return cls(
            np.array([time], float),
            np.array([place], float),
            np.array([frequency], float),
            np.array([heading], float),
        )

    def __len__(self) -> int:
        return len(self.times)

    def __add__(self, later: "Frames") -> "Frames":
        return Frames(
            np.concatenate([self.times, later.times]),
            np.concatenate([self.positions, later.positions]),
            np.concatenate([self.frequency, later.frequency]),
            np.concatenate([self.heading, later.heading]),
        )

    def __getitem__(self, places: slice | np.ndarray) -> "Frames":
        return Frames(
            self.times[places],
            self.positions[places],
            self.frequency[places],
            self.heading[places],
        )

    @property
    def observed(self) -> "Frames":
        """Those in which the robot was seen."""
        return self[~np.isnan(self.positions[:, 0])]
