"""A frame of reference that drifts slowly, such as a wall that the focus leaves."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.errors import InputError
from pinav.fitting.langevin.increments import Increments
from pinav.trajectories import Trajectories


class SlowReference(eqx.Module):
    r"""A coordinate whose zero drifts: fields depend on $x_i - w(t)$.

    w is linear between knots at equal times, its mean zero: that is a gauge, for the
    fields are learned with it.

    Attributes:
        axis: which coordinate.
        knots: number of them, over all the time of the data.
        scale: standard deviation of w [L]; chosen by the evidence unless given.
        start: w at the knots where the fit begins [L]; at rest unless given.

    Raises:
        InputError: there are fewer than two knots, `scale` is not positive, or `start`
            has not a value for each knot.
    """

    axis: int = eqx.field(static=True)
    knots: int = eqx.field(static=True, default=46)
    scale: float | None = None
    start: tuple[float, ...] | None = eqx.field(
        static=True,
        default=None,
        converter=lambda start: None if start is None else tuple(map(float, start)),
    )

    def __check_init__(self) -> None:
        if self.knots < 2 or not (self.scale is None or self.scale > 0):
            raise InputError(
                "SlowReference: expected two or more knots and a scale > 0, got "
                f"{self.knots} and {self.scale}"
            )
        if self.start is not None and len(self.start) != self.knots:
            raise InputError(
                f"SlowReference.start: expected {self.knots} values, one for each "
                f"knot, got {len(self.start)}"
            )


RELAXATIONS, MOST_KNOTS = 5, 200
"""Times of relaxation from one knot to the next, and knots at most."""


def slow_reference(trajectories: Trajectories, axis: int) -> SlowReference:
    r"""A reference with a knot every five relaxation times of a coordinate.

    Within that time $2\tau\,\mathrm{var}(x)/\langle\Delta x^2\rangle$ the motion
    itself goes from one end of the data to the other, and cannot be told from a drift.

    Args:
        trajectories: their channels are the positions, their times those of one clock.
        axis: the coordinate that drifts.

    Raises:
        InputError: there are no increments, or the coordinate never changes.
    """
    increments = Increments.of(trajectories)
    places, steps = increments.positions[:, axis], increments.steps[:, axis]
    change = float(np.mean(steps**2))
    if not change > 0:
        raise InputError(
            f"slow_reference axis {axis}: expected a coordinate that changes, got "
            f"{places[0]:g} throughout"
        )
    interval = float(np.median(increments.intervals))
    relaxation = 2 * interval * float(places.var()) / change
    ends = increments.times + increments.intervals
    duration = float(ends.max() - increments.times.min())
    knots = round(duration / (RELAXATIONS * relaxation))
    return SlowReference(axis, knots=min(max(knots, 2), MOST_KNOTS))


class ReferencePath(eqx.Module):
    """The path of a frame of reference.

    Attributes:
        axis: which coordinate.
        times: of the knots [T].
        values: there [L], of mean zero.
        covariance: of the values.
    """

    axis: int = eqx.field(static=True)
    times: Float[np.ndarray, " knot"]
    values: Float[np.ndarray, " knot"]
    covariance: Float[np.ndarray, "knot knot"]

    def __call__(self, times: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
        """Where the reference is at given times [L]."""
        return np.interp(times, self.times, self.values)

    @property
    def sd(self) -> Float[np.ndarray, " knot"]:
        """Standard deviation at each knot [L]."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
