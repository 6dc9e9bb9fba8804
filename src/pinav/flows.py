"""Background flows that carry a swimmer."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.actuation import Scalar


class AbstractFlow(eqx.Module):
    """Velocity of the fluid where the swimmer is. No batch axis."""

    @abc.abstractmethod
    def __call__(self, t: Scalar, x: Float[Array, " dim"]) -> Float[Array, " dim"]:
        """Velocity [L T⁻¹] at time `t` [T] and position `x` [L]."""


class ZeroFlow(AbstractFlow):
    """A fluid at rest."""

    def __call__(self, t, x):
        return jnp.zeros_like(x)
