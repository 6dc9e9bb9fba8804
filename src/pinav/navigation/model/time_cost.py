r"""Cost of time at a place: walls, margins, uncertainty."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector
from pinav.navigation.model.tables import FieldTable
from pinav.navigation.task.zones import AbstractZone, Rectangle, clearance


class TimeCost(eqx.Module):
    r"""Cost of a unit of time: 1, more near walls and where the model is uncertain.

    $$p(t, x) = 1 + k \max(0, 1 - c(x) / m)^2 + \rho\, (s(t, x) / u)^2,$$

    with the clearance c, the standard deviation s of the model's rate and the rate u
    that the greatest thrust gives.

    Attributes:
        keep_out: what must not be entered.
        arena: what must not be left.
        margin: m, from a wall, over which time costs more [L], positive.
        steepness: k.
        spread: s / u, dimensionless; zeros where the model is taken for true.
        risk_aversion: $\rho$ to what is not known.
    """

    keep_out: tuple[AbstractZone, ...]
    arena: Rectangle
    margin: Scalar
    steepness: float
    spread: FieldTable
    risk_aversion: Scalar

    def clearance(self, x: Vector) -> Float[Array, ""]:
        """Distance from the nearest forbidden place [L]."""
        return clearance(x, self.keep_out, self.arena)

    def running_cost(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        """Cost of a unit of time, at time `t` [T] and position `x` [L]."""
        return 1 + self.nearness(self.clearance(x)) + self.risk(t, x)

    def nearness(self, clearance: Float[Array, "*many"]) -> Float[Array, "*many"]:
        """Additional cost of time at this distance from forbidden places [L]."""
        lack = jnp.maximum(0.0, 1 - clearance / self.margin)
        return self.steepness * lack**2

    def risk(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        """Additional cost of time where the model is uncertain."""
        return self.risk_aversion * self.spread(t, x)[0] ** 2


def entry_fraction(
    x: Vector, displacement: Vector, goal: Vector, tolerance: Scalar
) -> Float[Array, ""]:
    """Fraction of a straight step after which it enters a ball; infinite if never.

    Args:
        x: where the step begins [L].
        displacement: the whole step [L].
        goal: middle of the ball [L].
        tolerance: its radius [L].
    """
    offset = x - goal
    beyond = offset @ offset - jnp.asarray(tolerance, x.dtype) ** 2
    square = displacement @ displacement
    approach = -(offset @ displacement)
    inner = approach**2 - square * beyond
    meets = (inner > 0) & (approach > 0)
    root = jnp.sqrt(jnp.where(meets, inner, 1.0))
    fraction = (approach - root) / jnp.where(meets, square, 1.0)
    fraction = jnp.where(meets & (fraction <= 1), fraction, jnp.inf)
    return jnp.where(beyond <= 0, 0.0, fraction)
