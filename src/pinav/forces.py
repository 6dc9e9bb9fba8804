r"""Forces on one swimmer, known and learned, and their algebra.

A force returns what is *added* to the acceleration, so a barrier returns
$-\nabla U$. The paper learns $\nabla\hat U$ and subtracts it; the learned
forces here are that field with its sign turned.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from pinav.actuation import AbstractField, Scalar
from pinav.errors import InputError


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
        converter=lambda value: _point("GaussianBarrier.center", value)
    )
    width: Scalar

    def __check_init__(self):
        if isinstance(self.width, float | int) and self.width <= 0:
            raise InputError(f"GaussianBarrier.width: expected > 0, got {self.width}")

    def potential(self, x: Float[Array, " dim"]) -> Float[Array, ""]:
        """Potential energy per mass $U(x)$ [L² T⁻²]."""
        offset = (x - self.center) / self.width
        return self.height * jnp.exp(-0.5 * offset @ offset)

    def __call__(self, t, x, v):
        return self.potential(x) * (x - self.center) / self.width**2


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
        converter=lambda value: _point("MagneticPropulsion.moment", value, 3)
    )
    gain: Scalar
    axis: Float[Array, " dim"] = eqx.field(
        converter=lambda value: _point("MagneticPropulsion.axis", value)
    )

    def torque(self, t: Scalar) -> Float[Array, "3"]:
        r"""Magnetic torque $m \times B(t)$ per mass [L² T⁻²]."""
        return jnp.cross(self.moment, self.field(t))

    def __call__(self, t, x, v):
        return self.gain * jnp.linalg.norm(self.torque(t)) * self.axis.astype(x.dtype)


class AbstractFeatures(eqx.Module):
    """What a learned force sees of (t, x, v), centred and scaled to order one."""

    center: eqx.AbstractVar[tuple[float, ...]]
    scale: eqx.AbstractVar[tuple[float, ...]]

    @abc.abstractmethod
    def __call__(
        self, t: Scalar, x: Float[Array, " dim"], v: Float[Array, " dim"]
    ) -> Float[Array, " features"]:
        """Dimensionless inputs of the network."""


class PositionFeatures(AbstractFeatures):
    """Position alone: a static environment.

    Attributes:
        center: subtracted from x [L]; fixed, never trained.
        scale: divides the difference [L]; fixed, never trained.
    """

    center: tuple[float, ...] = eqx.field(static=True)
    scale: tuple[float, ...] = eqx.field(static=True)

    def __call__(self, t, x, v):
        return (x - jnp.asarray(self.center, x.dtype)) / jnp.asarray(
            self.scale, x.dtype
        )


class PositionTimeFeatures(AbstractFeatures):
    """Position and time, as in the paper's network.

    Attributes:
        center: subtracted from (x, t) [L, T]; fixed, never trained.
        scale: divides the difference [L, T]; fixed, never trained.
    """

    center: tuple[float, ...] = eqx.field(static=True)
    scale: tuple[float, ...] = eqx.field(static=True)

    def __call__(self, t, x, v):
        inputs = jnp.append(x, jnp.asarray(t, x.dtype))
        return (inputs - jnp.asarray(self.center, x.dtype)) / jnp.asarray(
            self.scale, x.dtype
        )


class NeuralForce(AbstractForce):
    r"""Free force field $F(t, x) = f_0\,\mathrm{NN}_\theta(\text{features})$.

    It need not be the gradient of anything. Where no trajectory went its values
    are those of an untrained network.

    Attributes:
        network: the multilayer perceptron; its weights are what trains.
        features: what the network sees.
        scale: $f_0$ [L T⁻²], size of one unit of output; fixed, never trained.
    """

    network: eqx.nn.MLP
    features: AbstractFeatures
    scale: float = eqx.field(static=True, default=1.0)

    def __call__(self, t, x, v):
        return self.scale * self.network(self.features(t, x, v))


def tanh_network(
    in_size: int, out_size: int, *, width: int, depth: int, key: PRNGKeyArray
) -> eqx.nn.MLP:
    """A multilayer perceptron with tanh between its layers and a linear output.

    Args:
        in_size: number of inputs.
        out_size: number of outputs.
        width: neurons of each hidden layer, positive.
        depth: number of hidden layers, positive.
        key: random key of the weights.

    Raises:
        InputError: `width` or `depth` is not positive.
    """
    for name, value in (("width", width), ("depth", depth)):
        if value < 1:
            raise InputError(
                f"network {name}: expected a positive integer, got {value}"
            )
    return eqx.nn.MLP(in_size, out_size, width, depth, activation=jnp.tanh, key=key)


def paper_force(key: PRNGKeyArray) -> NeuralForce:
    """The paper's residual: 3-32-32-2 tanh network on raw (x, y, t) (Table 1)."""
    features = PositionTimeFeatures(center=(0.0, 0.0, 0.0), scale=(1.0, 1.0, 1.0))
    return NeuralForce(tanh_network(3, 2, width=32, depth=2, key=key), features)


def _terms(force: AbstractForce) -> tuple[AbstractForce, ...]:
    return force.terms if isinstance(force, SumForce) else (force,)


def _point(name: str, value, dim: int | None = None) -> Float[Array, " dim"]:
    """Array of a point given as list, tuple or array; `dim` components if given."""
    shape = np.shape(value)
    if len(shape) != 1 or (dim is not None and shape != (dim,)):
        expected = "(dim,)" if dim is None else f"({dim},)"
        raise InputError(f"{name}: expected a point of shape {expected}, got {shape}")
    return value if isinstance(value, jax.Array) else jnp.asarray(value, float)
