"""Forces that move with time."""

import abc

import equinox as eqx
import jax.numpy as jnp

from pinav.arguments import Scalar, Vector, point
from pinav.forces.force import AbstractForce


class AbstractMotion(eqx.Module):
    """How a thing moves."""

    @abc.abstractmethod
    def __call__(self, t: Scalar) -> Vector:
        """Displacement [L] at time `t` [T]."""


class LinearMotion(AbstractMotion):
    """Displacement at a constant velocity, from zero at t = 0.

    Attributes:
        velocity: [L T⁻¹].

    Raises:
        InputError: `velocity` is not a vector.
    """

    velocity: Vector = eqx.field(converter=point("LinearMotion.velocity"))

    def __call__(self, t: Scalar) -> Vector:
        return self.velocity * t


class CircularMotion(AbstractMotion):
    r"""Displacement $r (\cos(\omega t + \varphi), \sin(\omega t + \varphi))$.

    Attributes:
        radius: $r$ [L].
        frequency: $\omega$ [rad T⁻¹].
        phase: $\varphi$ [rad].
    """

    radius: Scalar
    frequency: Scalar
    phase: Scalar = 0.0

    def __call__(self, t: Scalar) -> Vector:
        angle = jnp.asarray(self.frequency * t + self.phase)
        return self.radius * jnp.stack([jnp.cos(angle), jnp.sin(angle)])


class Moving(AbstractForce):
    """A force whose source moves.

    Attributes:
        force: the force of the source where it stands without displacement.
        motion: displacement of the source in time.
    """

    force: AbstractForce
    motion: AbstractMotion

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.force(t, x - self.motion(t).astype(x.dtype), v)
