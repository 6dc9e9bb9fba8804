r"""Statements on increments before a fit, and on a fit of thermal motion after it.

Of thermal motion without inertia increments correlate with the next one alone:
$\rho_1 = (2D\tau R - \sigma^2)/(2D\tau(1 - 2R) + 2\sigma^2)$ with $R = T/6\tau$, which
lies between -1/2 (error alone) and 1/4 (an exposure as long as the interval). Smooth
motion, with inertia or propulsion, correlates more and farther.
"""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.fitting.engine.evidence_fit import SIGNIFICANT
from pinav.fitting.engine.posterior import Estimate
from pinav.fitting.langevin.increments import Increments, ObservedAxes
from pinav.trajectories import Trajectories

LAGS = 5
"""Correlations of innovations that are looked at."""

SLIGHT = 0.05
"""Correlation that is no misfit however significant: what it does to a drift or a
diffusion coefficient is below its size."""


class ThinnedDiffusion(eqx.Module):
    """Diffusion learned from every second or third sample, relative to that of all.

    Attributes:
        ratio: to the diffusion of all samples.
    """

    every: int = eqx.field(static=True)
    axes: tuple[int, ...] = eqx.field(static=True)
    ratio: Estimate


class LangevinChecks(eqx.Module):
    r"""Checks of the innovations and of the diffusion.

    Attributes:
        correlations: $\rho_1$ to $\rho_5$ of the innovations along each axis.
        counts: increments along each axis.
    """

    correlations: Float[np.ndarray, "lag axis"]
    counts: int
    thinned: tuple[ThinnedDiffusion, ...]
    observation: tuple[ObservedAxes, ...]

    @property
    def band(self) -> float:
        r"""$2/\sqrt N$, within which correlations of independent innovations lie."""
        return 2 / float(np.sqrt(self.counts))

    @property
    def is_adequate(self) -> bool:
        """Whether all checks pass."""
        return not self.failures

    @property
    def failures(self) -> tuple[str, ...]:
        """One sentence for each check that fails."""
        return (
            *self._correlation_remarks(),
            *(
                f"Diffusion along {_words(one.axes)} from every {one.every} samples is "
                f"{one.ratio.value:.3f}({one.ratio.sd:.3f}) times that of all: steps "
                "are too long, or the motion is not diffusive."
                for one in self.thinned
                if abs(one.ratio.value - 1) > SIGNIFICANT * one.ratio.sd + SLIGHT
            ),
            *(
                f"The exposure along {_words(one.axes)} fills the interval: the "
                "positions are smoothed over more than one sample."
                for one in self.observation
                if one.exposure.value > LONGEST_EXPOSURE * one.interval
            ),
        )

    def _correlation_remarks(self) -> tuple[str, ...]:
        limit = max(SIGNIFICANT * self.band / 2, SLIGHT)
        lags, axes = np.nonzero(np.abs(self.correlations) > limit)
        return tuple(
            f"Innovations along axis {axis} correlate by "
            f"{self.correlations[lag, axis]:+.3f} {lag + 1} samples apart: the motion "
            "has a memory, or the drift varies faster than the model."
            for lag, axis in zip(lags, axes, strict=True)
        )

    @property
    def statement(self) -> str:
        """What a terminal or a report says."""
        worst = float(np.abs(self.correlations).max())
        numbers = (
            f"largest correlation of innovations {worst:.3f} over lags 1 to {LAGS}, "
            f"{self.band:.3f} expected"
        )
        if self.is_adequate:
            return f"The fit explains the increments ({numbers})."
        return " ".join((f"The fit misses something ({numbers}).", *self.failures))


LONGEST_EXPOSURE = 0.97
"""Share of the interval from which on an exposure counts as all of it."""


def _words(axes: tuple[int, ...]) -> str:
    return "axis " + ", ".join(map(str, axes))


def innovation_correlations(
    series: list[Float[np.ndarray, "_ axis"]],
) -> Float[np.ndarray, "lag axis"]:
    r"""$\rho_1$ to $\rho_5$ along each axis of innovations in the order of time."""
    squares = sum((one**2).sum(axis=0) for one in series)
    sums = [
        sum((one[lag:] * one[:-lag]).sum(axis=0) for one in series)
        for lag in range(1, LAGS + 1)
    ]
    return np.stack(sums) / squares


BLOCKS = 40
"""Stretches of time whose scatter makes the standard deviation."""


def thinned_diffusion(
    residuals: list[Float[np.ndarray, "_ axis"]],
    expected: list[Float[np.ndarray, "_ axis"]],
    groups: tuple[tuple[int, ...], ...],
    every: int,
) -> tuple[ThinnedDiffusion, ...]:
    r"""Diffusion from every so many samples, relative to that of all.

    Args:
        residuals: increments of each track less their mean, in the order of time [L].
        expected: half of the variance by diffusion of each of them [L²].
        every: how many intervals make a step.

    Returns:
        Nothing where there are too few steps.
    """
    moments, motions = [], []
    for r, d in zip(residuals, expected, strict=True):
        count = len(r) // every
        if count > 1:
            shape = count, every, r.shape[1]
            steps = r[: count * every].reshape(shape).sum(axis=1)
            # a last step has no neighbour after it, and counts as none
            moments.append((0.5 * steps**2)[:-1] + steps[:-1] * steps[1:])
            motions.append(d[: count * every].reshape(shape).sum(axis=1)[:-1])
    if sum(map(len, moments)) < 2 * BLOCKS:
        return ()
    above, below = np.concatenate(moments), np.concatenate(motions)
    return tuple(
        ThinnedDiffusion(every, tuple(axes), _ratio(above[:, axes], below[:, axes]))
        for axes in map(list, groups)
    )


def _ratio(
    above: Float[np.ndarray, "step axis"], below: Float[np.ndarray, "step axis"]
) -> Estimate:
    """Ratio of two sums, its deviation from the scatter of blocks."""
    starts = np.linspace(0, len(above), BLOCKS, endpoint=False).astype(int)
    ratio = above.sum() / below.sum()
    misses = np.add.reduceat((above - ratio * below).sum(axis=1), starts)
    return Estimate(float(ratio), float(np.sqrt((misses**2).sum()) / below.sum()))


FARTHEST, MOST_BLUR = 0.1, 0.27
"""Correlation two and three increments apart that thermal motion may have, for forces
and vibrations make some (a trap negative ones); the largest between neighbours, of
blur."""

LEAST = 0.01
"""Sum of one half and the correlation below which error hides the motion."""

LONG = 0.3
"""Share of the relaxation time from which on a step is long."""


class IncrementVerdict(eqx.Module):
    r"""Correlations of increments, and what they mean.

    Attributes:
        correlations: $\rho_1$, $\rho_2$, $\rho_3$ of all axes together.
        count: pairs of neighbours, all axes.
        bias: of the one-lag diffusion, relative: that of a fit which counts positions
            as exact.
        relaxed: share of a relaxation that one step is, from the pull towards the mean
            of each track; small where there is none.
    """

    correlations: tuple[float, float, float]
    count: int
    bias: float
    relaxed: float

    @property
    def is_thermal(self) -> bool:
        """Whether this may be thermal motion without inertia."""
        near, *far = self.correlations
        return bool(-0.5 <= near < MOST_BLUR and max(far) < FARTHEST)

    @property
    def is_exact(self) -> bool:
        """Whether neither blur nor error is seen."""
        near = abs(self.correlations[0])
        return bool(near < SIGNIFICANT / np.sqrt(max(self.count, 1)))

    @property
    def statement(self) -> str:
        """Sentences for a terminal or a report."""
        near = self.correlations[0]
        said = f"Increments of neighbouring samples correlate by {near:+.3f}"
        if not self.is_thermal:
            return (
                f"{said}, and by {self.correlations[1]:+.3f} two samples apart: this "
                "is no thermal motion without inertia."
            )
        if self.relaxed > LONG:
            return (
                f"{said}: thermal motion whose steps are {self.relaxed:.2f} of the "
                "relaxation time, too long for a drift that is constant over them."
            )
        if self.is_exact:
            words = f"{said}: thermal motion without visible blur or error."
        elif near > 0:
            fraction = 6 * near / (1 + 2 * near)
            words = (
                f"{said}: thermal motion blurred over {fraction:.2f} of the interval "
                "or more; positions that count as exact make diffusion "
                f"{self.bias:+.0%}."
            )
        else:
            fraction = float(np.sqrt(-near / max(1 + 2 * near, LEAST)))
            words = (
                f"{said}: thermal motion with an error of {fraction:.2f} of a step or "
                f"more; positions that count as exact make diffusion {self.bias:+.0%}."
            )
        return words


def judge_increments(trajectories: Trajectories) -> IncrementVerdict:
    """The verdict on trajectories whose channels are positions.

    Raises:
        InputError: no trajectory has two samples with all positions observed.
    """
    increments = Increments.of(trajectories)
    rates = increments.steps / np.sqrt(increments.intervals)[:, None]
    series = np.split(rates, np.cumsum(increments.counts)[:-1])
    series = [one - one.mean(axis=0) for one in series if len(one) > 4]
    squares = sum(float((one**2).sum()) for one in series)
    near, second, third = (
        sum(float((one[lag:] * one[:-lag]).sum()) for one in series)
        / max(squares, np.finfo(float).tiny)
        for lag in (1, 2, 3)
    )
    return IncrementVerdict(
        correlations=(near, second, third),
        count=sum(one.size for one in series),
        bias=-near / max(0.5 + near, LEAST),
        relaxed=_relaxation(increments),
    )


def _relaxation(increments: Increments) -> float:
    """Pull towards the mean in one step, by the position one sample before.

    That position shares neither error nor exposure with the step.
    """
    above = below = 0.0
    starts = np.cumsum(increments.counts)[:-1]
    for steps, places in zip(
        np.split(increments.steps, starts),
        np.split(increments.positions, starts),
        strict=True,
    ):
        if len(steps) > 4:
            offsets = places - places.mean(axis=0)
            above -= float((steps[1:] * offsets[:-1]).sum())
            below += float((offsets[1:] * offsets[:-1]).sum())
    return above / below if below > 0 else 0.0
