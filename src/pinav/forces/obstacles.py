"""Sums and motion of obstacles, and random ones."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from pinav.arguments import Scalar, Vector, dimension, point
from pinav.errors import InputError
from pinav.forces.force import AbstractForce
from pinav.forces.landscapes import GaussianBarrier, gaussian_ridge
from pinav.settings import Range


class Superposition(AbstractForce):
    """Sum of many forces of one kind: quicker to compile than a `SumForce`.

    Attributes:
        stacked: a force whose arrays have one more axis, the first, such as
            `eqx.filter_vmap(GaussianBarrier)` makes; plain numbers are common to all.
    """

    stacked: AbstractForce

    @classmethod
    def of(cls, terms: tuple[AbstractForce, ...]) -> "Superposition":
        """The sum of forces of one class; InputError for none or several classes."""
        if len({jax.tree.structure(term) for term in terms}) != 1:
            raise InputError(
                "Superposition.of terms: expected forces of one class, got "
                f"{', '.join(type(term).__name__ for term in terms) or 'none'}"
            )
        return cls(jax.tree.map(lambda *leaves: jnp.stack(leaves), *terms))

    @property
    def terms(self) -> tuple[AbstractForce, ...]:
        """The forces one by one."""
        arrays, common = eqx.partition(self.stacked, eqx.is_array)
        count = jax.tree.leaves(arrays)[0].shape[0]
        return tuple(
            eqx.combine(jax.tree.map(lambda a, i=i: a[i], arrays), common)
            for i in range(count)
        )

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        one = eqx.filter_vmap(lambda f: f(t, x, v), in_axes=(eqx.if_array(0),))
        return jnp.sum(one(self.stacked), axis=0)


class AbstractMotion(eqx.Module):
    """Motion of the source of a force."""

    @abc.abstractmethod
    def __call__(self, t: Scalar) -> Vector:
        """Displacement [L] at time `t` [T]."""


class LinearMotion(AbstractMotion):
    """Displacement at a constant velocity, from zero at t = 0.

    Attributes:
        velocity: velocity of the obstacle [L T⁻¹].

    Raises:
        InputError: `velocity` is not a vector.
    """

    velocity: Vector = eqx.field(
        metadata=dimension("L T-1"), converter=point("LinearMotion.velocity")
    )

    def __call__(self, t: Scalar) -> Vector:
        return self.velocity * t


class CircularMotion(AbstractMotion):
    r"""Displacement $r (\cos(\omega t + \varphi), \sin(\omega t + \varphi))$.

    Attributes:
        radius: $r$ [L].
        frequency: $\omega$ [rad T⁻¹].
        phase: $\varphi$ [rad].
    """

    radius: Scalar = eqx.field(metadata=dimension("L"))
    frequency: Scalar = eqx.field(metadata=dimension("rad T-1"))
    phase: Scalar = eqx.field(metadata=dimension("rad"), default=0.0)

    def __call__(self, t: Scalar) -> Vector:
        angle = jnp.asarray(self.frequency * t + self.phase)
        return self.radius * jnp.stack([jnp.cos(angle), jnp.sin(angle)])


class Moving(AbstractForce):
    """A force whose source moves, given as it stands without displacement."""

    force: AbstractForce
    motion: AbstractMotion

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.force(t, x - self.motion(t).astype(x.dtype), v)


class Domain(eqx.Module):
    """A box with edges along the axes, from `lower` to `upper` [L], in any dimension.

    Raises:
        InputError: `upper` is not beyond `lower` along every axis.
    """

    lower: tuple[float, ...] = eqx.field(static=True)
    upper: tuple[float, ...] = eqx.field(static=True)

    def __check_init__(self) -> None:
        pairs = list(zip(self.lower, self.upper, strict=False))
        if len(self.lower) != len(self.upper) or not all(a < b for a, b in pairs):
            raise InputError(
                f"Domain: expected upper beyond lower, got {self.lower}, {self.upper}"
            )

    def points(self, key: PRNGKeyArray, count: int) -> Float[Array, "{count} dim"]:
        """Uniform random points; more points of a key begin with the same ones."""
        lower, upper = jnp.asarray([self.lower]), jnp.asarray([self.upper])
        return lower + (upper - lower) * jax.random.uniform(
            key, (count, len(self.lower))
        )

    def spread_points(
        self, key: PRNGKeyArray, count: int
    ) -> Float[Array, "{count} dim"]:
        """Random points that keep apart: each the best of 16, by its nearest one.

        References:
            Mitchell, SIGGRAPH 1991: best-candidate sampling.
        """
        candidates = np.asarray(self.points(key, 16 * count)).reshape(count, 16, -1)
        chosen = candidates[0, :1]
        for several in candidates[1:]:
            gaps = np.linalg.norm(several[:, None] - chosen[None], axis=-1)
            chosen = np.vstack([chosen, several[gaps.min(axis=1).argmax()]])
        return jnp.asarray(chosen)


def random_barriers(
    domain: Domain,
    count: int,
    *,
    heights: tuple[float, float],
    widths: tuple[float, float],
    key: PRNGKeyArray,
) -> Superposition:
    """Gaussian barriers that keep apart, with uniform heights and widths.

    Args:
        heights: least and greatest height [L² T⁻²].
        widths: least and greatest width [L].

    Raises:
        InputError: `count` is not positive.
    """
    Range(least=1).check("random_barriers count", count)
    where, how_high, how_wide = jax.random.split(key, 3)
    centers = domain.spread_points(where, count)
    height = _uniform(how_high, heights, count)
    width = _uniform(how_wide, widths, count)
    return Superposition(eqx.filter_vmap(GaussianBarrier)(height, centers, width))


def random_fibres(
    domain: Domain,
    count: int,
    *,
    heights: tuple[float, float],
    length: float,
    width: float,
    key: PRNGKeyArray,
) -> Superposition:
    """Gaussian ridges that keep apart, in random directions.

    Args:
        heights: least and greatest height [L² T⁻²].
        length: along each fibre [L].
        width: across each fibre [L].

    Raises:
        InputError: `count` is not positive.
    """
    Range(least=1).check("random_fibres count", count)
    where, how_high, direction = jax.random.split(key, 3)
    centers = domain.spread_points(where, count)
    height = _uniform(how_high, heights, count)
    angle = _uniform(direction, (0.0, np.pi), count)
    sizes = jnp.full((count,), length), jnp.full((count,), width)
    return Superposition(
        eqx.filter_vmap(gaussian_ridge)(height, centers, *sizes, angle)
    )


def _uniform(
    key: PRNGKeyArray, limits: tuple[float, float], count: int
) -> Float[Array, " {count}"]:
    return jax.random.uniform(key, (count,), minval=limits[0], maxval=limits[1])
