"""Rules by which the initial states of a system are drawn."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from pinav.errors import InputError
from pinav.forces import Domain
from pinav.settings import Range


class AbstractStarts(eqx.Module):
    """Random initial states: positions, and velocities where there is inertia.

    More starts of a key begin with the same ones; `count` are drawn by the key of
    `seed` unless others are asked for.
    """

    count: eqx.AbstractVar[int]
    seed: eqx.AbstractVar[int]

    @abc.abstractmethod
    def states(
        self, key: PRNGKeyArray, count: int, order: int
    ) -> Float[Array, "{count} state"]:
        """Initial states of a first-order (x) or second-order (x, v) swimmer."""

    def draw(
        self, order: int, key: PRNGKeyArray | None = None, count: int | None = None
    ) -> Float[Array, "trajectory state"]:
        """Initial states, by the rule's own seed and number unless others are given.

        Raises:
            InputError: `count` is not positive.
        """
        Range(least=1).check("starts count", count)
        key = jax.random.key(self.seed) if key is None else key
        return _states(self, key, self.count if count is None else count, order)


@eqx.filter_jit
def _states(
    rule: AbstractStarts, key: PRNGKeyArray, count: int, order: int
) -> Float[Array, "{count} state"]:
    """One compiled program in place of one for each operation."""
    return rule.states(key, count, order)


class RingStarts(AbstractStarts):
    """Starts on a circle in the plane, aimed near its centre.

    Angles are uniform; the aim is the centre plus a normal offset; the speed is
    uniform. A swimmer without inertia has positions only.

    Attributes:
        spread: standard deviation of the aim in each coordinate [L].
        speeds: least and greatest speed [L T⁻¹].
    """

    center: tuple[float, float]
    radius: float
    spread: float = 0.0
    speeds: tuple[float, float] = (0.0, 0.0)
    count: int = eqx.field(static=True, default=8)
    seed: int = eqx.field(static=True, default=0)

    def states(
        self, key: PRNGKeyArray, count: int, order: int
    ) -> Float[Array, "{count} state"]:
        angle_key, offset_key, speed_key = jax.random.split(key, 3)
        center = jnp.array([self.center])
        angles = jax.random.uniform(angle_key, (count,), maxval=2 * np.pi)
        directions = jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1)
        positions = center + self.radius * directions
        if order == 1:
            return positions
        targets = center + self.spread * jax.random.normal(offset_key, (count, 2))
        aims = targets - positions
        slowest, fastest = self.speeds
        speeds = jax.random.uniform(
            speed_key, (count, 1), minval=slowest, maxval=fastest
        )
        velocities = speeds * aims / jnp.linalg.norm(aims, axis=1, keepdims=True)
        return jnp.concatenate([positions, velocities], axis=1)


class UniformStarts(AbstractStarts):
    """Uniform positions in a box [L] of any dimension; velocities are zero."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    count: int = eqx.field(static=True, default=8)
    seed: int = eqx.field(static=True, default=0)

    def states(
        self, key: PRNGKeyArray, count: int, order: int
    ) -> Float[Array, "{count} state"]:
        positions = Domain(self.lower, self.upper).points(key, count)
        return jnp.concatenate([positions] + [0 * positions] * (order - 1), axis=1)


class CoastingStarts(AbstractStarts):
    r"""Uniform starts in a box, with the velocity that would coast to a uniform target.

    Drag alone brings a swimmer to rest after the way $v_0 / \eta$, so it starts with
    $v_0 = \eta (x_1 - x_0)$: fast where the way is long, and inside of the box.

    Attributes:
        damping: $\eta$ [T⁻¹].
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    damping: float
    count: int = eqx.field(static=True, default=32)
    seed: int = eqx.field(static=True, default=0)

    def states(
        self, key: PRNGKeyArray, count: int, order: int
    ) -> Float[Array, "{count} state"]:
        if order == 1:
            raise InputError(
                "starts: coasting needs inertia, and the system is of first order; "
                "choose uniform starts"
            )
        start_key, target_key = jax.random.split(key)
        box = Domain(self.lower, self.upper)
        positions = box.points(start_key, count)
        velocities = self.damping * (box.points(target_key, count) - positions)
        return jnp.concatenate([positions, velocities], axis=1)
