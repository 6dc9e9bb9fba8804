r"""Known forces on one swimmer, and their algebra.

A force returns what is *added* to the acceleration, so a barrier returns
$-\nabla U$.
"""

import abc
from collections.abc import Mapping

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar


class AbstractForce(eqx.Module):
    """Mass-specific force on one swimmer. No batch axis: batch with `jax.vmap`."""

    @abc.abstractmethod
    def __call__(
        self, t: Scalar, x: Float[Array, " dim"], v: Float[Array, " dim"]
    ) -> Float[Array, " dim"]:
        """Force [L T⁻²] at time `t` [T], position `x` [L], velocity `v` [L T⁻¹]."""

    def __add__(self, other: "AbstractForce") -> "SumForce":
        """The sum of two forces is a force."""
        return SumForce((*_terms(self), *_terms(other)))


class SumForce(AbstractForce):
    """Sum of forces, each a term of its own.

    Attributes:
        terms: the forces that add up.
    """

    terms: tuple[AbstractForce, ...]

    def __call__(self, t, x, v):
        return sum((force(t, x, v) for force in self.terms), jnp.zeros_like(x))


class ZeroForce(AbstractForce):
    """No force: what the physics-only baseline puts where the unknown stands."""

    def __call__(self, t, x, v):
        return jnp.zeros_like(x)


def _terms(force: AbstractForce) -> tuple[AbstractForce, ...]:
    return force.terms if isinstance(force, SumForce) else (force,)


class AbstractLearnedForce(AbstractForce):
    """A force whose parameters come from data."""

    @property
    @abc.abstractmethod
    def parameters(self) -> PyTree:
        """The leaves that train."""


class AbstractCommandedForce(AbstractForce):
    """A force that the operator's commands drive; each trajectory has its own."""

    @property
    @abc.abstractmethod
    def unbound(self) -> bool:
        """Whether the commands are still to come."""

    @abc.abstractmethod
    def driven_by(
        self,
        times: Float[Array, " time"],
        commands: Mapping[str, Float[Array, " time"]],
    ) -> AbstractForce:
        """The force under commands that hold until the next one.

        Args:
            times: when each command was given [T].
            commands: what was commanded, by name.

        Raises:
            InputError: a command that the force needs is missing.
        """
