"""The hypotheses of the bank: response, delay, and kind of the wandering velocity.

The strength of the wandering is not among them: each member learns its own. Frequencies
are those of magnetic coils, delays those of a camera and its computer.
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
