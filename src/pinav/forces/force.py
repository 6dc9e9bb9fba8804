r"""Known forces on one swimmer, and their algebra.

A force returns what is *added* to the acceleration, so a barrier returns
$-\nabla U$.
"""

import abc
from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, PyTree

from pinav.actuation import AbstractActuator, AbstractProgramme
from pinav.arguments import Scalar, Vector, refuse_text
from pinav.forces.priors import AbstractPrior, Centers, Shape


class AbstractForce(eqx.Module):
    """Mass-specific force on one swimmer. No batch axis: batch with `jax.vmap`."""

    def __check_init__(self) -> None:
        refuse_text(self)

    @abc.abstractmethod
    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        """Force [L T⁻²] at time `t` [T], position `x` [L], velocity `v` [L T⁻¹]."""

    def __add__(self, other: "AbstractForce") -> "SumForce":
        """The sum of two forces is a force."""
        return SumForce((*_terms(self), *_terms(other)))


class AbstractPotentialForce(AbstractForce):
    r"""Force $-\nabla U$ of a known potential, by automatic differentiation."""

    @abc.abstractmethod
    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        """Potential energy per mass $U(t, x)$ [L² T⁻²]."""

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return -jax.grad(self.potential, argnums=1)(t, x)


class SumForce(AbstractForce):
    """Sum of forces, each a term of its own."""

    terms: tuple[AbstractForce, ...]

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return sum((force(t, x, v) for force in self.terms), jnp.zeros_like(x))


class ZeroForce(AbstractForce):
    """No force: what the physics-only baseline puts where the unknown stands."""

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return jnp.zeros_like(x)


@eqx.filter_jit
def forces_at(
    force: AbstractForce,
    times: Float[ArrayLike, "*shape"],
    points: Float[ArrayLike, "*shape dim"],
) -> Float[Array, "*shape dim"]:
    """The force on a swimmer at rest at each of many places, as one program."""
    times, points = jnp.asarray(times), jnp.asarray(points)
    at_rest = jax.vmap(lambda t, x: force(t, x, jnp.zeros_like(x)))
    places = points.reshape(-1, points.shape[-1])
    return at_rest(times.reshape(-1), places).reshape(points.shape)


def _terms(force: AbstractForce) -> tuple[AbstractForce, ...]:
    return force.terms if isinstance(force, SumForce) else (force,)


class AbstractLearnedForce(AbstractForce):
    """A force whose weights come from data.

    A fit asks nothing else of it than these methods, so that a new kind of kernels or
    networks is one new class.
    """

    @property
    @abc.abstractmethod
    def parameters(self) -> PyTree:
        """The leaves that train."""

    @property
    def geometry(self) -> PyTree:
        """Further leaves that train, each with a wide prior; none in most forces."""
        return ()

    @property
    def geometry_scales(self) -> tuple[float, ...]:
        """Prior standard deviation of each leaf of the geometry."""
        return ()

    @property
    @abc.abstractmethod
    def dim(self) -> int:
        """Dimension of the space in which it acts."""

    @abc.abstractmethod
    def prior(self) -> AbstractPrior:
        """Prior of the weights, flattened as they are."""

    @abc.abstractmethod
    def kernels_on(self, centers: Centers, width: float) -> "AbstractLearnedForce":
        """The same kind of force, untrained, from static kernels at other places.

        Finer kernels for a force of kernels; for a network the kernels that stand for
        the same class of fields.
        """

    @property
    def trainable(self) -> PyTree:
        """All leaves that train, those of the geometry included."""
        return (self.parameters, self.geometry) if self.geometry else self.parameters

    @property
    def kind(self) -> str:
        """Name of its kind, as progress bars show it; empty where it has none."""
        return ""

    @property
    def helmholtz(self) -> "HelmholtzParts | None":
        """Its gradient and its rotational part, where it holds both apart."""
        return None

    @property
    def periods(self) -> dict[int, float]:
        """Period [L] of each coordinate in which it repeats itself."""
        return {}

    @property
    def is_linear(self) -> bool:
        """True if the force is linear in its weights."""
        return True

    @property
    def is_static(self) -> bool:
        """True if the force does not depend on time."""
        return True

    @property
    def is_conservative(self) -> bool:
        """True if the force is the gradient of a potential that is constant in time."""
        return False

    @property
    def kernels(self) -> "KernelPlaces | None":
        """Its kernels on a grid that may be refined; None where there are none."""
        return None

    def length_scales(self, shape: Shape) -> list[float]:
        """Length scale of each part in widths; empty if too fine for any grid."""
        return []


class KernelPlaces(NamedTuple):
    """Centres and width of kernels [L]."""

    centers: Float[Array, "kernel dim"]
    width: Scalar


class HelmholtzParts(NamedTuple):
    """The two parts of a planar force."""

    gradient: AbstractLearnedForce
    rotation: AbstractLearnedForce


def as_learned_force(force: AbstractForce) -> AbstractLearnedForce | None:
    """A force that has weights as such; None for any other."""
    return force if isinstance(force, AbstractLearnedForce) else None


class AbstractCommandedForce(AbstractForce):
    """A force that commands drive: its programme, or those of each trajectory."""

    programme: eqx.AbstractVar[AbstractProgramme | None]

    @property
    def unbound(self) -> bool:
        """True while the commands are still to come."""
        return self.programme is None

    @property
    @abc.abstractmethod
    def actuator(self) -> AbstractActuator:
        """The effect of a held command, by which the swimmer can be steered."""

    @property
    @abc.abstractmethod
    def lateness(self) -> float:
        """Time from a command to its effect, lags included [T]."""

    @abc.abstractmethod
    def drive_by(
        self,
        times: Float[Array, " time"],
        commands: Mapping[str, Float[Array, " time"]],
    ) -> AbstractForce:
        """The force under commands, given at times [T], that hold until the next one.

        Raises:
            InputError: a command that the force needs is missing.
        """
