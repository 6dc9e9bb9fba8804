r"""A bank of Kalman filters, one for each hypothesis about the drive.

Along each axis the state is $(p, w, b, g_1, g_2)$: position, wandering velocity, drift
and a row of the gain matrix. From one block to the next

$$p' = p + g \cdot \Delta C + b\,\Delta t + T (1 - e^{-\Delta t/T})\, w + \epsilon$$

with an Ornstein-Uhlenbeck velocity w of memory T. Both axes have the same regressors
and noise, so that one covariance serves both. All variances are in units of an unknown
$\sigma^2$, the wandering at 1 Hz, whose inverse has a gamma posterior: its integral is
the evidence, and no grid of strengths is needed.

References:
    West and Harrison, Bayesian Forecasting and Dynamic Models (1997), section 4.5, for
    the unknown variance.
"""

import itertools

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, Int

from pinav.identification.kalman import ornstein_uhlenbeck

PerMember = Float[np.ndarray, " member"]
"""A number for each member of a bank."""

P, W, B, G = 0, 1, 2, slice(3, 5)
"""Places in the state."""

STILL = 0.3
"""Wandering speed at rest, in parts of that at 1 Hz."""

DRIFT_PRIOR, GAIN_PRIOR = 3.0, 100.0
"""Standard deviations of the priors of drift and gain, in wandering speeds at 1 Hz."""

SIGMA_PRIOR = 0.1
"""Wandering speed at 1 Hz that is expected, in parts of the speed there."""


class Bank(eqx.Module):
    r"""States of all members.

    Attributes:
        covariance: covariance of each member, the same along both axes, over
            $\sigma^2$.
        log_weight: logarithm of the evidence of each member, less that of the best.
        squares: rate of the gamma posterior of $1/\sigma^2$ of each member.
        count: shape of that posterior, the same for all.
    """

    mean: Float[np.ndarray, "member 2 5"]
    covariance: Float[np.ndarray, "member 5 5"]
    log_weight: PerMember
    squares: PerMember
    count: float

    @classmethod
    def prior(cls, log_prior: PerMember, scale: float) -> "Bank":
        """The bank before any block."""
        members = len(log_prior)
        covariance = np.zeros((members, 5, 5))
        covariance[:, B, B] = DRIFT_PRIOR**2
        covariance[:, 3, 3] = covariance[:, 4, 4] = GAIN_PRIOR**2
        squares = np.full(members, (SIGMA_PRIOR * scale) ** 2)
        return cls(np.zeros((members, 2, 5)), covariance, log_prior, squares, 1.0)

    @property
    def weight(self) -> PerMember:
        """Posterior probability of each member."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        return weight / weight.sum()

    @property
    def variance_unit(self) -> PerMember:
        r"""Mean of $\sigma^2$ of each member [L² T⁻²]."""
        return self.squares / max(self.count - 1.0, 1.0)

    def place(self, position: Float[np.ndarray, "2"], blur: PerMember) -> "Bank":
        """At a position that says nothing of the past; the wandering begins anew."""
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[:, :, P], mean[:, :, W] = position, 0.0
        for place, variance in ((P, blur**2), (W, 1.0)):
            covariance[:, place, :] = covariance[:, :, place] = 0.0
            covariance[:, place, place] = variance
        return eqx.tree_at(lambda b: (b.mean, b.covariance), self, (mean, covariance))

    def predict(
        self,
        cycles: Float[np.ndarray, "member 2"],
        interval: float,
        memory: PerMember,
        frequency: float,
    ) -> "Bank":
        """The states after an interval."""
        decay = np.exp(-interval / memory)
        row = rows(cycles, interval, memory)
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[:, :, P] = np.einsum("mas,ms->ma", self.mean, row)
        mean[:, :, W] *= decay[:, None]
        across = np.einsum("mst,mt->ms", self.covariance, row)
        covariance[:, P, :] = covariance[:, :, P] = across
        covariance[:, P, P] = np.einsum("ms,ms->m", across, row)
        covariance[:, W, :] *= decay[:, None]
        covariance[:, :, W] *= decay[:, None]
        position, cross, velocity = wandering(interval, memory, frequency)
        covariance[:, P, P] += position
        covariance[:, P, W] += cross
        covariance[:, W, P] += cross
        covariance[:, W, W] += velocity
        return eqx.tree_at(lambda b: (b.mean, b.covariance), self, (mean, covariance))

    def update(self, position: Float[np.ndarray, "2"], blur: PerMember) -> "Bank":
        r"""The states and weights after a block's mean position [L], blur in [s]."""
        variance = self.covariance[:, P, P] + blur**2
        column = self.covariance[:, :, P]
        gain = column / variance[:, None]
        innovation = position - self.mean[:, :, P]
        mean = self.mean + innovation[:, :, None] * gain[:, None]
        # Column times column, not gain times column: symmetric to the last bit.
        known = column[:, :, None] * column[:, None] / variance[:, None, None]
        squares = self.squares + 0.5 * (innovation**2).sum(axis=1) / variance
        log_weight = self.log_weight - np.log(variance)
        log_weight += self.count * np.log(self.squares)
        log_weight -= (self.count + 1) * np.log(squares)
        return Bank(
            mean,
            self.covariance - known,
            log_weight - log_weight.max(),
            squares,
            self.count + 1.0,
        )


def rows(
    cycles: Float[np.ndarray, "*batch member 2"],
    interval: float | Float[np.ndarray, "*#batch 1"],
    memory: PerMember,
) -> Float[np.ndarray, "*batch member 5"]:
    """Displacement by each part of the state after an interval [s]."""
    row = np.empty((*cycles.shape[:-1], 5))
    row[..., P], row[..., B] = 1.0, interval
    row[..., W] = memory * -np.expm1(-interval / memory)
    row[..., G] = cycles
    return row


def wandering(
    interval: float, memory: PerMember, frequency: float | Float[np.ndarray, "*plan 1"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r"""Variances by wandering in an interval at a frequency [Hz], over $\sigma^2$.

    They are those of position, of position with velocity, and of velocity.
    """
    strength = STILL**2 + np.sqrt(np.maximum(frequency, 0.0))
    lost, _, spread, fresh = ornstein_uhlenbeck(interval / memory, np)
    return (
        strength * memory**2 * spread,
        strength * memory * lost**2,
        strength * fresh,
    )


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

    The strength of the wandering is not among them: each member learns its own.
    Frequencies are those of magnetic coils, delays those of a camera and its computer.

    A *drive* is a pair of delay and response, counted delays first.

    Attributes:
        corners: corner frequency of each response [Hz]; infinite where it is linear.
        residuals: part of the gain that each response keeps above it.
        blur: noise of a block's mean position, over the wandering speed at 1 Hz [s].
    """

    corners: Float[np.ndarray, " response"]
    residuals: Float[np.ndarray, " response"]
    delays: Float[np.ndarray, " delay"]
    drive: Int[np.ndarray, " member"]
    blur: PerMember
    memory: PerMember
    log_prior: PerMember

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
    def member_delay(self) -> PerMember:
        """Delay of each member [s]."""
        return self.delays[self.drive // len(self.corners)]


class Frames(eqx.Module):
    """Positions [L] and the commands [Hz, rad] applied from each time on.

    Attributes:
        positions: NaN where the robot was not seen.
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
        values = (time, place, frequency, heading)
        return cls(*(np.array([value], float) for value in values))

    def __len__(self) -> int:
        return len(self.times)

    def __add__(self, later: "Frames") -> "Frames":
        return jax.tree.map(lambda *both: np.concatenate(both), self, later)

    def __getitem__(self, places: slice | np.ndarray) -> "Frames":
        return jax.tree.map(lambda values: values[places], self)

    @property
    def observed(self) -> "Frames":
        """Those in which the robot was seen."""
        return self[~np.isnan(self.positions[:, 0])]


REACH = 2.0
"""Commands are kept for so much longer than the longest delay [s]."""


class CommandHistory(eqx.Module):
    r"""Held commands, and $C(t) = \int s(f) n(\theta) dt$ at the time of each.

    Attributes:
        rates: effective velocity per gain from each on, by response [Hz].
    """

    times: Float[np.ndarray, " command"]
    rates: Float[np.ndarray, "command response 2"]
    integrals: Float[np.ndarray, "command response 2"]

    @classmethod
    def begin(cls, grid: DriveGrid, frame: Frames) -> "CommandHistory":
        """The command of one frame, held from then on, and no drive before it."""
        rates = effective_rates(grid, frame.frequency, frame.heading)
        return cls(frame.times, rates, np.zeros_like(rates))

    def extend(self, grid: DriveGrid, later: Frames) -> "CommandHistory":
        """The history with the commands of later frames."""
        added = effective_rates(grid, later.frequency, later.heading)
        rates = np.concatenate([self.rates, added])
        times = np.concatenate([self.times, later.times])
        first = len(self.times) - 1
        steps = np.diff(times[first:])[:, None, None] * rates[first:-1]
        moved = self.integrals[-1] + np.cumsum(steps, axis=0)
        return CommandHistory(times, rates, np.concatenate([self.integrals, moved]))

    def forget(self, before: float) -> "CommandHistory":
        """Without what ended before a time; integrals keep their origin."""
        first = max(int(np.searchsorted(self.times, before, side="right")) - 1, 0)
        if first == 0:
            return self
        return CommandHistory(
            self.times[first:], self.rates[first:], self.integrals[first:]
        )

    def at(
        self, times: Float[np.ndarray, "time delay"]
    ) -> Float[np.ndarray, "time drive 2"]:
        """Integrals of the commands up to delayed times [cycles].

        Drives are counted delays first, then responses.
        """
        place = np.searchsorted(self.times, times, side="right") - 1
        elapsed = np.where(place < 0, 0.0, times - self.times[np.maximum(place, 0)])
        place = np.maximum(place, 0)
        values = self.integrals[place] + elapsed[..., None, None] * self.rates[place]
        return values.reshape(len(times), -1, 2)


def effective_rates(
    grid: DriveGrid,
    frequency: Float[np.ndarray, "*times"],
    heading: Float[np.ndarray, "*times"],
) -> Float[np.ndarray, "*times response 2"]:
    """Velocity per gain that commands ask for, by response [Hz]."""
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return grid.response(frequency)[..., None] * direction[..., None, :]
