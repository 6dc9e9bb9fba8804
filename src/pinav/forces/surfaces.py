"""Surfaces that bound a fluid: a plane, a straight tube, and tubes that meet."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector, check_positive, dimension, point
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
    position: Scalar = eqx.field(metadata=dimension("L"), default=0.0)

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
    radius: Scalar = eqx.field(metadata=dimension("L"))

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


class Bifurcation(AbstractSurface):
    r"""The wall of tubes that meet in a point and lead away from it, with fluid inside.

    With two tubes that continue each other it is a straight tube; with three it is the
    Y of a vessel that parts. The fluid fills the union of the tubes, each of which
    begins with half a ball about the point. With $d_i$ the distance from the wall of
    tube i, and nothing outside of it,

    $$d = \frac{\sum_i w_i d_i}{\sum_i w_i}, \qquad w_i = d_i^8,$$

    and the normal is that mean of theirs: exact in each tube, smooth where they
    overlap, and nowhere more than the largest $d_i$, which is a lower bound of the
    distance from the wall of the union.

    Attributes:
        middle: where the axes meet [L].
        along: directions that lead away from there; their lengths are without effect.
        radii: $R_i$ of the tubes [L], positive.

    Raises:
        InputError: `middle` is not a point in space, `along` and `radii` are not those
            of two tubes or more, a direction is zero, or a radius is <= 0.
    """

    middle: Float[Array, "3"] = eqx.field(converter=point("Bifurcation.middle", 3))
    along: Float[Array, "tube 3"] = eqx.field(converter=jnp.asarray)
    radii: Float[Array, " tube"] = eqx.field(converter=jnp.asarray)

    def __check_init__(self) -> None:
        if self.along.ndim != 2 or self.along.shape[1] != 3 or len(self.along) < 2:
            raise InputError(
                "Bifurcation.along: expected the directions of two tubes or more, of "
                f"shape (tube, 3), got {self.along.shape}"
            )
        if self.radii.shape != (len(self.along),):
            raise InputError(
                f"Bifurcation.radii: expected {len(self.along)} of them, one for each "
                f"direction, got {self.radii.shape}"
            )
        if isinstance(self.along, Tracer) or isinstance(self.radii, Tracer):
            return
        if not bool(jnp.all(self.radii > 0)):
            raise InputError(f"Bifurcation.radii: expected > 0, got {self.radii}")
        if not bool(jnp.all(jnp.any(self.along != 0, axis=1))):
            raise InputError("Bifurcation.along: expected vectors that are not zero")

    @property
    def axes(self) -> Float[Array, "tube 3"]:
        """Unit vectors that lead away along the tubes."""
        return self.along / jnp.linalg.norm(self.along, axis=1, keepdims=True)

    def from_axes(self, x: Vector) -> Float[Array, "tube 3"]:
        """The ways from the nearest points of the axes to a point [L]."""
        offset = x - self.middle.astype(x.dtype)

        def across(axis: Float[Array, "3"]) -> Float[Array, "3"]:
            return offset - jnp.maximum(axis @ offset, 0.0) * axis

        return jax.vmap(across)(self.axes.astype(x.dtype))

    def distance(self, x: Vector) -> Float[Array, ""]:
        distances = self._distances(self.from_axes(x))
        largest = jnp.max(distances)
        mean = jnp.sum(_nearness(distances) * distances)
        return jnp.where(largest > 0, mean, largest)

    def normal_at(self, x: Vector) -> Vector:
        across = self.from_axes(x)
        inwards = -across / jax.vmap(_length)(across)[:, None]
        mean = _nearness(self._distances(across)) @ inwards
        return mean / _length(mean)

    def _distances(self, across: Float[Array, "tube 3"]) -> Float[Array, " tube"]:
        return self.radii.astype(across.dtype) - jax.vmap(_length)(across)


SHARPNESS = 8
"""Power of the distance by which the tubes count that a point lies in."""


def _nearness(distances: Float[Array, " tube"]) -> Float[Array, " tube"]:
    """Weight of each tube at a point; outside of all, the nearest one alone."""
    largest = jax.lax.stop_gradient(jnp.max(distances))
    inside = largest > 0
    scale = jnp.where(inside, largest, 1.0)
    weights = (jnp.maximum(distances, 0.0) / scale) ** SHARPNESS
    weights = jnp.where(inside, weights, (distances == largest).astype(distances.dtype))
    return weights / jnp.sum(weights)


def _length(vector: Vector) -> Float[Array, ""]:
    """Length of a vector, a little more where it vanishes: its gradient stays finite.

    On the axis of a tube no side is nearest; the normal is zero there.
    """
    return jnp.sqrt(vector @ vector + TINY)


TINY = 1e-24
"""Square of the length below which a point counts as on the axis [L²]."""
