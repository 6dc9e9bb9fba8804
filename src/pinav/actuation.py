"""What the operator commands: the magnetic field that drives the swimmer."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

Scalar = float | int | Float[Array, ""]
"""One real number: plain, NumPy's float64, or a JAX array without axes."""


class AbstractField(eqx.Module):
    """A uniform magnetic field that varies in time."""

    @abc.abstractmethod
    def __call__(self, t: Scalar) -> Float[Array, "3"]:
        """Field [B] at time `t` [T]."""


class RotatingField(AbstractField):
    r"""Field $B(t) = B_0 [\cos\omega t, \sin\omega t, 0]$ rotating in the plane.

    Attributes:
        amplitude: $B_0$ [B].
        frequency: angular frequency $\omega$ [rad T⁻¹].

    References:
        PI-NAV paper, section 2.2.
    """

    amplitude: Scalar
    frequency: Scalar

    def __call__(self, t):
        phase = self.frequency * jnp.asarray(t)
        direction = jnp.stack([jnp.cos(phase), jnp.sin(phase), jnp.zeros_like(phase)])
        return self.amplitude * direction
