"""Hypotheses about the drive, and the last commands as each of them has it.

The strength of the wandering is not among them: each member of the bank learns its own.
Frequencies are those of magnetic coils, delays those of a camera and its computer.
"""

import itertools

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

CORNERS = tuple(np.geomspace(0.25, 8.0, 6))
"""Corner frequencies of the responses [Hz]."""

RESIDUALS = (0.03, 0.12, 0.3, 0.55)
"""Parts of the gain that remain far above the corner."""

DELAYS = tuple(np.arange(0.0, 0.65, 0.1))
"""Delays of the commands [s]."""

DELAY_PRIOR = (0.2, 0.2)
"""Mean and standard deviation of the delay [s], as in identification."""

BLURS = (0.05, 0.2, 0.8)
"""Noise of the mean position of a block, over the wandering speed at 1 Hz [s]."""

MEMORIES = (0.4, 1.2)
"""Correlation times of the wandering velocity [s]."""


class DriveGrid(eqx.Module):
    """The members of the bank: each a delay, a response, and a kind of noise.

    A *drive* is a pair of delay and response, counted delays first.

    Attributes:
        corners: corner frequency of each response [Hz]; infinite where it is linear.
        residuals: part of the gain that each response keeps above it.
        delays: delays [s].
        drive: drive of each member.
        blur: noise of a block's mean position, over the wandering speed at 1 Hz [s].
        memory: correlation time of each member [s].
        log_prior: logarithm of the prior weight of each member.
    """

    corners: Float[np.ndarray, " response"]
    residuals: Float[np.ndarray, " response"]
    delays: Float[np.ndarray, " delay"]
    drive: Int[np.ndarray, " member"]
    blur: Float[np.ndarray, " member"]
    memory: Float[np.ndarray, " member"]
    log_prior: Float[np.ndarray, " member"]

    @classmethod
    def default(cls) -> "DriveGrid":
        """The grid that was judged on recorded sessions (docs/live.md)."""
        responses = [(np.inf, 1.0), *itertools.product(CORNERS, RESIDUALS)]
        corners, residuals = np.array(responses).T
        delays = np.array(DELAYS)
        drives = len(delays) * len(responses)
        noises = np.array(list(itertools.product(BLURS, MEMORIES)))
        drive = np.repeat(np.arange(drives), len(noises))
        blur, memory = np.tile(noises, (drives, 1)).T
        mean, sd = DELAY_PRIOR
        log_prior = -0.5 * ((delays[drive // len(responses)] - mean) / sd) ** 2
        log_prior -= np.log(np.exp(log_prior).sum())
        return cls(corners, residuals, delays, drive, blur, memory, log_prior)

    def response(
        self, frequency: Float[np.ndarray, "*times"]
    ) -> Float[np.ndarray, "*times response"]:
        r"""Effective frequencies $\rho f + (1 - \rho) f / \sqrt{1 + (f / f_c)^2}$ [Hz].

        That of `SlippingResponse`; an infinite corner is the linear law.
        """
        f = frequency[..., None]
        slip = f / np.sqrt(1 + (f / self.corners) ** 2)
        return self.residuals * f + (1 - self.residuals) * slip

    @property
    def member_response(self) -> Int[np.ndarray, " member"]:
        """Place of the response of each member."""
        return self.drive % len(self.corners)

    @property
    def member_delay(self) -> Float[np.ndarray, " member"]:
        """Delay of each member [s]."""
        return self.delays[self.drive // len(self.corners)]


REACH = 2.0
"""Commands are kept for so much longer than the longest delay [s]."""


class CommandHistory(eqx.Module):
    r"""Held commands, and $C(t) = \int s(f) n(\theta) dt$ at the time of each.

    Attributes:
        times: time of each command [s].
        rates: effective velocity per gain from each on, by response [Hz].
        integrals: integral of the rates up to each command [cycles].
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
