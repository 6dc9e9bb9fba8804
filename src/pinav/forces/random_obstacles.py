"""Random fields of obstacles in a domain."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from pinav.errors import InputError
from pinav.forces.landscapes import GaussianBarrier
from pinav.forces.obstacles import GaussianRidge, Superposition


class Domain(eqx.Module):
    """A box with edges along the axes, in any dimension: a rectangle in the plane.

    Attributes:
        lower: its lower corner [L].
        upper: its upper corner [L].

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
        domain: holds their centres.
        count: how many, positive.
        heights: least and greatest height [L² T⁻²].
        widths: least and greatest width [L].
        key: random key of the field.

    Raises:
        InputError: `count` is not positive.
    """
    _check_count("random_barriers", count)
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
        domain: holds their centres.
        count: how many, positive.
        heights: least and greatest height [L² T⁻²].
        length: along each fibre [L].
        width: across each fibre [L].
        key: random key of the field.

    Raises:
        InputError: `count` is not positive.
    """
    _check_count("random_fibres", count)
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


def _check_count(name: str, count: int) -> None:
    if count < 1:
        raise InputError(f"{name} count: expected 1 or more, got {count}")
