r"""Known forces on one swimmer, and their algebra.

A force returns what is *added* to the acceleration, so a barrier returns
$-\nabla U$.
"""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.actuation import AbstractField, Scalar
from pinav.errors import InputError
from pinav.flows import AbstractFlow
from pinav.tensors import AbstractTensorField, as_point, check_positive


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


class LinearDrag(AbstractForce):
    r"""Viscous drag $-\eta v$.

    Attributes:
        damping: $\eta$ [T⁻¹], not negative.

    Raises:
        InputError: `damping` is a negative number.

    References:
        PI-NAV paper, eq. (2).
    """

    damping: Scalar

    def __check_init__(self):
        if isinstance(self.damping, float | int) and self.damping < 0:
            raise InputError(f"LinearDrag.damping: expected >= 0, got {self.damping}")

    def __call__(self, t, x, v):
        return -self.damping * v


class TensorDrag(AbstractForce):
    r"""Viscous drag $-\Gamma(x) v$ that depends on direction or place.

    A `UniaxialTensor` makes it anisotropic, with a constant or varying director; a
    `BrinkmanTensor` makes it that of a porous medium; a `CholeskyTensor` trains; an
    `IsotropicTensor` is a `LinearDrag`.

    Attributes:
        tensor: $\Gamma$ [T⁻¹].
    """

    tensor: AbstractTensorField

    def __call__(self, t, x, v):
        return -self.tensor(x, v)


class InFlow(AbstractForce):
    """A force that sees the velocity relative to the fluid: a drag in a current.

    Attributes:
        force: such as `LinearDrag`.
        flow: the velocity of the fluid.
    """

    force: AbstractForce
    flow: AbstractFlow

    def __call__(self, t, x, v):
        return self.force(t, x, v - self.flow(t, x))


class Advection(AbstractForce):
    """What a current does to a swimmer without inertia whose mobility is 1.

    As an environment it makes the current what is unknown; as the flow of an
    `OverdampedSwimmer` it would be known.

    Attributes:
        flow: the velocity of the fluid.
    """

    flow: AbstractFlow

    def __call__(self, t, x, v):
        return self.flow(t, x)


class GaussianBarrier(AbstractForce):
    r"""Repulsion $-\nabla U$ from $U(x) = U_0 \exp(-|x - c|^2 / 2\sigma^2)$.

    Attributes:
        height: $U_0$ [L² T⁻²]; negative makes a trap.
        center: $c$ [L].
        width: $\sigma$ [L], positive.

    Raises:
        InputError: `center` is not a point, or `width` is a number <= 0.

    References:
        PI-NAV paper, eq. (1); its centre is (5, 5).
    """

    height: Scalar
    center: Float[Array, " dim"] = eqx.field(
        converter=lambda value: as_point("GaussianBarrier.center", value)
    )
    width: Scalar

    def __check_init__(self):
        check_positive(self, "width")

    def potential(self, x: Float[Array, " dim"]) -> Float[Array, ""]:
        """Potential energy per mass $U(x)$ [L² T⁻²]."""
        offset = (x - self.center) / self.width
        return self.height * jnp.exp(-0.5 * offset @ offset)

    def __call__(self, t, x, v):
        return self.potential(x) * (x - self.center) / self.width**2


class HarmonicTrap(AbstractForce):
    r"""Pull $-\nabla U$ from $U(x) = k |x - c|^2 / 2$, as of an optical tweezer.

    Attributes:
        stiffness: $k$ [T⁻²]; negative pushes away.
        center: $c$ [L].

    Raises:
        InputError: `center` is not a point.
    """

    stiffness: Scalar
    center: Float[Array, " dim"] = eqx.field(
        converter=lambda value: as_point("HarmonicTrap.center", value)
    )

    def potential(self, x: Float[Array, " dim"]) -> Float[Array, ""]:
        """Potential energy per mass $U(x)$ [L² T⁻²]."""
        offset = x - self.center
        return 0.5 * self.stiffness * (offset @ offset)

    def __call__(self, t, x, v):
        return -self.stiffness * (x - self.center)


class MagneticPropulsion(AbstractForce):
    r"""Thrust $\alpha\,|m \times B(t)|\,\hat a$ along the fixed body axis.

    With the paper's $m = \hat z$ and a field rotating in the plane the torque has
    the constant size $|m| B_0$: the thrust is constant and cannot steer.

    Attributes:
        field: the magnetic field $B(t)$.
        moment: dipole moment $m$ [J B⁻¹ per mass].
        gain: $\alpha$ [L⁻¹], thrust per torque.
        axis: unit vector $\hat a$ of the body.

    Raises:
        InputError: `moment` has not three components.

    References:
        PI-NAV paper, section 2.2.
    """

    field: AbstractField
    moment: Float[Array, "3"] = eqx.field(
        converter=lambda value: as_point("MagneticPropulsion.moment", value, 3)
    )
    gain: Scalar
    axis: Float[Array, " dim"] = eqx.field(
        converter=lambda value: as_point("MagneticPropulsion.axis", value)
    )

    def torque(self, t: Scalar) -> Float[Array, "3"]:
        r"""Magnetic torque $m \times B(t)$ per mass [L² T⁻²]."""
        return jnp.cross(self.moment, self.field(t))

    def __call__(self, t, x, v):
        return self.gain * jnp.linalg.norm(self.torque(t)) * self.axis.astype(x.dtype)


def _terms(force: AbstractForce) -> tuple[AbstractForce, ...]:
    return force.terms if isinstance(force, SumForce) else (force,)
