"""Fibres, swirls, sums and motion of obstacles."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from pinav.arguments import Scalar, Vector, check_positive, dimension, point
from pinav.errors import InputError
from pinav.forces.force import AbstractForce, AbstractPotentialForce
from pinav.forces.formulas import NUMERIC
from pinav.forces.landscapes import GaussianBarrier
from pinav.forces.profiles import Gaussian
from pinav.settings import Range


class GaussianRidge(AbstractPotentialForce):
    r"""Repulsion $-\nabla U$ from an elongated Gaussian in the plane: a fibre.

    $U(x) = U_0 \exp(-\tfrac12 (a^2 / l^2 + b^2 / w^2))$, with the coordinates $a$ along
    and $b$ across the ridge. With $l = w$ it is a `GaussianBarrier`.

    Attributes:
        height: $U_0$ [L² T⁻²].
        center: $c$ [L].
        length: $l$ along the ridge [L], positive.
        width: $w$ across it [L], positive.
        angle: of the ridge to the x axis [rad].

    Raises:
        InputError: `center` is not a point in the plane, or `length` or `width` is a
            number <= 0.
    """

    height: Scalar = eqx.field(metadata=dimension("L2 T-2"))
    center: Float[Array, "2"] = eqx.field(
        metadata=dimension("L"), converter=point("GaussianRidge.center", 2)
    )
    length: Scalar = eqx.field(metadata=dimension("L"))
    width: Scalar = eqx.field(metadata=dimension("L"))
    angle: Scalar = eqx.field(metadata=dimension("rad"))

    def __check_init__(self) -> None:
        check_positive(self, "length", "width")

    def potential(self, t: Scalar, x: Float[Array, "2"]) -> Float[Array, ""]:
        offset = x - self.center
        cos, sin = jnp.cos(self.angle), jnp.sin(self.angle)
        along = (cos * offset[0] + sin * offset[1]) / self.length
        across = (cos * offset[1] - sin * offset[0]) / self.width
        return self.height * Gaussian().of_square((1.0,), along**2 + across**2, NUMERIC)


class GaussianSwirl(AbstractForce):
    r"""Rotational force $(\partial_y \psi, -\partial_x \psi)$ in the plane.

    With $\psi(x) = S \exp(-|x - c|^2 / 2w^2)$: it has no potential and no divergence.
    Over the whole plane $\int |F|^2 = \pi S^2$, as it is $\pi U_0^2$ for a
    `GaussianBarrier`, whatever the widths; the two are orthogonal there.

    Attributes:
        strength: $S$ [L² T⁻²]; positive pushes counter-clockwise.
        center: $c$ [L].
        width: $w$ [L], positive.

    Raises:
        InputError: `center` is not a point in the plane, or `width` a number <= 0.
    """

    strength: Scalar = eqx.field(metadata=dimension("L2 T-2"))
    center: Float[Array, "2"] = eqx.field(
        metadata=dimension("L"), converter=point("GaussianSwirl.center", 2)
    )
    width: Scalar = eqx.field(metadata=dimension("L"))

    def __check_init__(self) -> None:
        check_positive(self, "width")

    def stream(self, x: Float[Array, "2"]) -> Float[Array, ""]:
        r"""Stream function $\psi(x)$ [L² T⁻²]."""
        offset = x - self.center
        square = offset @ offset
        return self.strength * Gaussian().of_square((self.width,), square, NUMERIC)

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        slope = jax.grad(self.stream)(x)
        return jnp.stack([slope[1], -slope[0]])


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
    return Superposition(eqx.filter_vmap(GaussianRidge)(height, centers, *sizes, angle))


def _uniform(
    key: PRNGKeyArray, limits: tuple[float, float], count: int
) -> Float[Array, " {count}"]:
    return jax.random.uniform(key, (count,), minval=limits[0], maxval=limits[1])
