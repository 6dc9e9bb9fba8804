r"""What increments say before a fit: thermal or not, blur, error, length of the steps.

Of thermal motion without inertia increments correlate with the next one alone:
$\rho_1 = (2D\tau R - \sigma^2)/(2D\tau(1 - 2R) + 2\sigma^2)$ with $R = T/6\tau$, which
lies between -1/2 (error alone) and 1/4 (an exposure as long as the interval). Smooth
motion, with inertia or propulsion, correlates more and farther.
"""

import equinox as eqx
import numpy as np

from pinav.fitting.langevin.increments import Increments
from pinav.trajectories import Trajectories

CERTAIN = 4.0
"""Standard deviations of chance beyond which a correlation is one."""

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
        return bool(near < CERTAIN / np.sqrt(max(self.count, 1)))

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

    Args:
        trajectories: the paths.

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
