"""Surfaces that bound a fluid: a plane, and a straight tube."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector, check_positive, point
from pinav.errors import InputError


class AbstractSurface(eqx.Module):
    """A surface with fluid on one side."""

    @abc.abstractmethod
    def distance(self, x: Vector) -> Float[Array, ""]:
        """Distance of a point from the surface [L]; negative behind it."""

    @abc.abstractmethod
    def normal_at(self, x: Vector) -> Vector:
        """Unit vector into the fluid where the surface is nearest to a point."""


class Plane(AbstractSurface):
    r"""A plane $\{x : n \cdot x = p\}$ that bounds the fluid on the side of $n$.

    Attributes:
        normal: $n$, which points into the fluid; its length is without effect.
        position: $p$ [L], measured along the unit normal from the origin.

    Raises:
        InputError: `normal` is no vector, or zero.
    """

    normal: Vector = eqx.field(converter=point("Plane.normal"))
    position: Scalar = 0.0

    def __check_init__(self) -> None:
        if not jnp.any(self.normal != 0):
            raise InputError("Plane.normal: expected a vector that is not zero")

    @property
    def unit_normal(self) -> Vector:
        """$n$ with the length 1."""
        return self.normal / jnp.linalg.norm(self.normal)

    def distance(self, x: Vector) -> Float[Array, ""]:
        return self.unit_normal.astype(x.dtype) @ x - self.position

    def normal_at(self, x: Vector) -> Vector:
        return self.unit_normal.astype(x.dtype)


class Tube(AbstractSurface):
    r"""The wall of a straight tube, with fluid inside.

    Attributes:
        along: direction of its axis; its length is without effect.
        middle: a point of its axis [L].
        radius: $R$ [L], positive.

    Raises:
        InputError: `along` or `middle` is not a point in space, `along` is zero, or
            `radius` is a number <= 0.
    """

    along: Float[Array, "3"] = eqx.field(converter=point("Tube.along", 3))
    middle: Float[Array, "3"] = eqx.field(converter=point("Tube.middle", 3))
    radius: Scalar

    def __check_init__(self) -> None:
        check_positive(self, "radius")
        if not jnp.any(self.along != 0):
            raise InputError("Tube.along: expected a vector that is not zero")

    @property
    def axis(self) -> Float[Array, "3"]:
        """Unit vector along the tube."""
        return self.along / jnp.linalg.norm(self.along)

    def from_axis(self, x: Vector) -> Vector:
        """The way from the axis to a point, across the tube [L]."""
        axis = self.axis.astype(x.dtype)
        offset = x - self.middle.astype(x.dtype)
        return offset - (axis @ offset) * axis

    def distance(self, x: Vector) -> Float[Array, ""]:
        return self.radius - _length(self.from_axis(x))

    def normal_at(self, x: Vector) -> Vector:
        across = self.from_axis(x)
        return -across / _length(across)


def _length(vector: Vector) -> Float[Array, ""]:
    """Length of a vector, a little more where it vanishes: its gradient stays finite.

    On the axis of a tube no side is nearest; the normal is zero there.
    """
    return jnp.sqrt(vector @ vector + TINY)


TINY = 1e-24
"""Square of the length below which a point counts as on the axis [L²]."""
