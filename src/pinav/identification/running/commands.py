"""The last seconds of commands, integrated for each response of the bank."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.identification.running.grid import DriveGrid

REACH = 2.0
"""Commands are kept for so much longer than the longest delay [s]."""


class CommandHistory(eqx.Module):
    r"""Held commands, and $C(t) = \int s(f) n(\theta) dt$ at the time of each.

    Attributes:
        times: of the commands [s].
        rates: effective velocity per gain from each on, by response [Hz].
        integrals: of the rates up to each [cycles].
    """

    times: Float[np.ndarray, " command"]
    rates: Float[np.ndarray, "command response 2"]
    integrals: Float[np.ndarray, "command response 2"]

    @classmethod
    def begin(
        cls, grid: DriveGrid, time: float, frequency: float, heading: float
    ) -> "CommandHistory":
        """One command, held from `time` on, and no drive before it."""
        rates = effective_rates(grid, np.array([frequency]), np.array([heading]))
        return cls(np.array([time]), rates, np.zeros_like(rates))

    def extend(
        self,
        grid: DriveGrid,
        times: Float[np.ndarray, " later"],
        frequency: Float[np.ndarray, " later"],
        heading: Float[np.ndarray, " later"],
    ) -> "CommandHistory":
        """The history with later commands, whose times increase."""
        rates = np.concatenate([self.rates, effective_rates(grid, frequency, heading)])
        times = np.concatenate([self.times, times])
        first = len(self.times) - 1
        steps = np.diff(times[first:])[:, None, None] * rates[first:-1]
        later = self.integrals[-1] + np.cumsum(steps, axis=0)
        return CommandHistory(times, rates, np.concatenate([self.integrals, later]))

    def replace_last(
        self,
        grid: DriveGrid,
        frequency: Float[np.ndarray, "1"],
        heading: Float[np.ndarray, "1"],
    ) -> "CommandHistory":
        """The history with another command from its last time on."""
        rates = np.concatenate(
            [self.rates[:-1], effective_rates(grid, frequency, heading)]
        )
        return CommandHistory(self.times, rates, self.integrals)

    def forget(self, before: float) -> "CommandHistory":
        """Without what ended before a time; integrals keep their origin."""
        first = max(int(np.searchsorted(self.times, before, side="right")) - 1, 0)
        if first == 0:
            return self
        return CommandHistory(
            self.times[first:], self.rates[first:], self.integrals[first:]
        )

    def at(
        self, times: Float[np.ndarray, " time"], delays: Float[np.ndarray, " delay"]
    ) -> Float[np.ndarray, "time drive 2"]:
        """Integrals of the delayed commands [cycles], delays first, then responses."""
        query = times[:, None] - delays
        place = np.searchsorted(self.times, query, side="right") - 1
        elapsed = query - self.times[np.maximum(place, 0)]
        elapsed = np.where(place < 0, 0.0, elapsed)
        place = np.maximum(place, 0)
        values = self.integrals[place] + elapsed[..., None, None] * self.rates[place]
        return values.reshape(len(times), -1, 2)


def effective_rates(
    grid: DriveGrid,
    frequency: Float[np.ndarray, "*times"],
    heading: Float[np.ndarray, "*times"],
) -> Float[np.ndarray, "*times response 2"]:
    """Velocity per gain that commands ask for, by response [Hz].

    Args:
        grid: the hypotheses.
        frequency: [Hz].
        heading: [rad].
    """
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return grid.response(frequency)[..., None] * direction[..., None, :]
