"""Learned forces: what may stand where the unknown environment's force would be.

All are forces of equal rank. Each names the leaves that train; the centre and scale of
its inputs and outputs, and the centres of a kernel, are fixed.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from pinav.arguments import Scalar, Vector
from pinav.errors import InputError
from pinav.forces.force import AbstractLearnedForce
from pinav.forces.kernels import KernelForce, KernelPotential
from pinav.forces.priors import Centers, IsotropicPrior


class AbstractFeatures(eqx.Module):
    """Inputs of a learned force from (t, x, v), centred and scaled to order one."""

    center: eqx.AbstractVar[tuple[float, ...]]
    scale: eqx.AbstractVar[tuple[float, ...]]

    @property
    @abc.abstractmethod
    def dim(self) -> int:
        """Dimension of the space."""

    @property
    @abc.abstractmethod
    def is_static(self) -> bool:
        """True if the features do not depend on time."""

    @abc.abstractmethod
    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Float[Array, " features"]:
        """Dimensionless inputs of the network."""

    def standardise(
        self, inputs: Float[Array, " features"]
    ) -> Float[Array, " features"]:
        """Inputs less the centre, over the scale."""
        center, scale = (
            jnp.asarray(a, inputs.dtype) for a in (self.center, self.scale)
        )
        return (inputs - center) / scale


class PositionFeatures(AbstractFeatures):
    """Position alone, as (x - center) / scale with fixed numbers [L]."""

    center: tuple[float, ...] = eqx.field(static=True)
    scale: tuple[float, ...] = eqx.field(static=True)

    @property
    def dim(self) -> int:
        return len(self.center)

    @property
    def is_static(self) -> bool:
        return True

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Float[Array, " features"]:
        return self.standardise(x)


class PositionTimeFeatures(AbstractFeatures):
    """Position and time, (y - center) / scale with y = (x, t), both fixed [L, T]."""

    center: tuple[float, ...] = eqx.field(static=True)
    scale: tuple[float, ...] = eqx.field(static=True)

    @property
    def dim(self) -> int:
        return len(self.center) - 1

    @property
    def is_static(self) -> bool:
        return False

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Float[Array, " features"]:
        return self.standardise(jnp.append(x, jnp.asarray(t, x.dtype)))


class AbstractNeuralForce(AbstractLearnedForce):
    """A network of features, whose weights train; each class says what it gives."""

    network: eqx.AbstractVar[eqx.nn.MLP]
    features: eqx.AbstractVar[AbstractFeatures]

    @property
    def parameters(self) -> PyTree:
        return self.network

    @property
    def dim(self) -> int:
        return self.features.dim

    @property
    def is_linear(self) -> bool:
        return False

    @property
    def is_static(self) -> bool:
        return self.features.is_static

    def prior(self) -> IsotropicPrior:
        leaves = jax.tree.leaves(eqx.filter(self.network, eqx.is_array))
        return IsotropicPrior(sum(leaf.size for leaf in leaves))


class NeuralForce(AbstractNeuralForce):
    r"""Free force field $F(t, x) = f_0\,\mathrm{NN}_\theta(\text{features})$.

    It need not be the gradient of anything. Where no trajectory went its values
    are those of an untrained network.

    Attributes:
        scale: $f_0$ [L T⁻²], size of one unit of output; fixed, never trained.
    """

    network: eqx.nn.MLP
    features: AbstractFeatures
    scale: float = eqx.field(static=True, default=1.0)

    def kernels_on(self, centers: Centers, width: float) -> KernelForce:
        return KernelForce.with_zero_weights(centers, width)

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.scale * self.network(self.features(t, x, v))


class NeuralPotential(AbstractNeuralForce):
    r"""Conservative force $-\nabla U$, $U = f_0\,\mathrm{NN}_\theta(\text{features})$.

    Attributes:
        scale: $f_0$ [L² T⁻²], size of one unit of potential; fixed, never trained.
    """

    network: eqx.nn.MLP
    features: AbstractFeatures
    scale: float = eqx.field(static=True, default=1.0)

    @property
    def is_conservative(self) -> bool:
        return self.is_static

    def kernels_on(self, centers: Centers, width: float) -> KernelPotential:
        return KernelPotential.with_zero_weights(centers, width)

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        """Potential energy per mass $U(t, x)$ [L² T⁻²]."""
        features = self.features(t, x, jnp.zeros_like(x))
        return self.scale * self.network(features)[0]

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return -jax.grad(self.potential, argnums=1)(t, x)


def tanh_network(
    in_size: int, out_size: int, *, width: int, depth: int, key: PRNGKeyArray
) -> eqx.nn.MLP:
    """A perceptron with tanh after its `depth` hidden layers and a linear output.

    Raises:
        InputError: `width` or `depth` is not positive.
    """
    for name, value in (("width", width), ("depth", depth)):
        if value < 1:
            raise InputError(
                f"network {name}: expected a positive integer, got {value}"
            )
    # One compiled program in place of one for each array.
    draw = eqx.filter_jit(eqx.nn.MLP)
    return draw(in_size, out_size, width, depth, activation=jnp.tanh, key=key)


@eqx.filter_jit
def spread_weights(network: eqx.nn.MLP) -> eqx.nn.MLP:
    r"""The network with all weights and biases times $\sqrt 3$.

    Equinox draws them uniformly with variance 1/(3 n) for n inputs; after this it is
    1/n, which keeps standardised signals of order one through the layers. Gauss-Newton
    reaches a far lower error from there (docs/fitting.md).
    """
    return jax.tree.map(
        lambda leaf: 3**0.5 * leaf if eqx.is_inexact_array(leaf) else leaf, network
    )


def paper_force(key: PRNGKeyArray) -> NeuralForce:
    """The paper's residual: 3-32-32-2 tanh network on raw (x, y, t) (Table 1)."""
    features = PositionTimeFeatures(center=(0.0, 0.0, 0.0), scale=(1.0, 1.0, 1.0))
    return NeuralForce(tanh_network(3, 2, width=32, depth=2, key=key), features)
