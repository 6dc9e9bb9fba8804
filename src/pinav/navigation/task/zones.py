"""Places where a swimmer must not be, as signed distances."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from pinav.arguments import Planar, Scalar, check_positive, point
from pinav.errors import InputError


class AbstractZone(eqx.Module):
    """A region of the plane."""

    @abc.abstractmethod
    def distance(self, x: Planar) -> Float[Array, ""]:
        """Signed distance from its edge [L]: negative inside."""


class Disc(AbstractZone):
    """A disc.

    Attributes:
        center: [L].
        radius: [L], positive.

    Raises:
        InputError: `center` is not a point in the plane, or `radius` a number <= 0.
    """

    center: Planar = eqx.field(converter=point("Disc.center", 2))
    radius: Scalar

    def __check_init__(self) -> None:
        check_positive(self, "radius")

    def distance(self, x: Planar) -> Float[Array, ""]:
        return _length(x - self.center) - self.radius


class Wall(AbstractZone):
    """A straight wall with round ends.

    Attributes:
        start: where its middle line begins [L].
        end: where it ends [L].
        half_width: from the middle line to the surface [L], positive.

    Raises:
        InputError: an end is not a point in the plane, or `half_width` a number <= 0.
    """

    start: Planar = eqx.field(converter=point("Wall.start", 2))
    end: Planar = eqx.field(converter=point("Wall.end", 2))
    half_width: Scalar

    def __check_init__(self) -> None:
        check_positive(self, "half_width")

    def distance(self, x: Planar) -> Float[Array, ""]:
        along = self.end - self.start
        fraction = jnp.clip((x - self.start) @ along / (along @ along), 0.0, 1.0)
        return _length(x - self.start - fraction * along) - self.half_width


class Rectangle(AbstractZone):
    """A rectangle along the axes: also the arena, which must not be left.

    Attributes:
        lower: corner of least x and y [L].
        upper: corner of greatest x and y [L].

    Raises:
        InputError: a corner is not a point in the plane, or `lower` is not below
            `upper`.
    """

    lower: Planar = eqx.field(converter=point("Rectangle.lower", 2))
    upper: Planar = eqx.field(converter=point("Rectangle.upper", 2))

    def __check_init__(self) -> None:
        lower, upper = self.lower, self.upper
        if not isinstance(lower, Tracer) and not bool(jnp.all(lower < upper)):
            raise InputError(
                f"Rectangle: expected lower below upper, got {lower} and {upper}"
            )

    def distance(self, x: Planar) -> Float[Array, ""]:
        beyond = jnp.maximum(self.lower - x, x - self.upper)
        outside = _length(jnp.maximum(beyond, 0.0))
        return outside + jnp.minimum(jnp.max(beyond), 0.0)


def clearance(
    x: Planar, keep_out: tuple[AbstractZone, ...], arena: Rectangle
) -> Float[Array, ""]:
    """Distance from the nearest forbidden place [L]: negative inside of one."""
    distances = [zone.distance(x) for zone in keep_out]
    return jnp.min(jnp.stack([*distances, -arena.distance(x)]))


def _length(offset: Planar) -> Float[Array, ""]:
    """Length of a vector, with a gradient of zero where it vanishes."""
    square = offset @ offset
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)
