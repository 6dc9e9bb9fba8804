"""A frame of reference that drifts slowly, such as a wall that the focus leaves."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.errors import InputError


class SlowReference(eqx.Module):
    r"""A coordinate whose zero drifts: fields depend on $x_i - w(t)$.

    w is linear between knots at equal times, its mean zero: that is a gauge, for the
    fields are learned with it.

    Attributes:
        axis: which coordinate.
        knots: number of them, over all the time of the data.
        scale: standard deviation of w [L]; chosen by the evidence unless given.

    Raises:
        InputError: there are fewer than two knots, or `scale` is not positive.
    """

    axis: int = eqx.field(static=True)
    knots: int = eqx.field(static=True, default=46)
    scale: float | None = None

    def __check_init__(self) -> None:
        if self.knots < 2 or not (self.scale is None or self.scale > 0):
            raise InputError(
                "SlowReference: expected two or more knots and a scale > 0, got "
                f"{self.knots} and {self.scale}"
            )


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
