"""Learned forces: what may stand where the unknown environment's force would be.

All are forces of equal rank. Each names the leaves that train; the centre and scale of
its inputs and outputs, and the centres of a kernel, are fixed.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from pinav.actuation import Scalar
from pinav.errors import InputError
from pinav.forces import AbstractForce


class AbstractLearnedForce(AbstractForce):
    """A force whose parameters come from data."""

    @property
    @abc.abstractmethod
    def parameters(self) -> PyTree:
        """The leaves that train."""


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


class NeuralForce(AbstractLearnedForce):
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

    @property
    def parameters(self):
        return self.network

    def __call__(self, t, x, v):
        return self.scale * self.network(self.features(t, x, v))


class NeuralPotential(AbstractLearnedForce):
    r"""Conservative force $-\nabla U$, $U = f_0\,\mathrm{NN}_\theta(\text{features})$.

    Attributes:
        network: the multilayer perceptron, one output; its weights are what trains.
        features: what the network sees.
        scale: $f_0$ [L² T⁻²], size of one unit of potential; fixed, never trained.
    """

    network: eqx.nn.MLP
    features: AbstractFeatures
    scale: float = eqx.field(static=True, default=1.0)

    @property
    def parameters(self):
        return self.network

    def potential(self, t: Scalar, x: Float[Array, " dim"]) -> Float[Array, ""]:
        """Potential energy per mass $U(t, x)$ [L² T⁻²]."""
        features = self.features(t, x, jnp.zeros_like(x))
        return self.scale * self.network(features)[0]

    def __call__(self, t, x, v):
        return -jax.grad(self.potential, argnums=1)(t, x)


class KernelForce(AbstractLearnedForce):
    r"""Free force field $F(x) = \sum_j w_j \exp(-|x - c_j|^2 / 2 b^2)$.

    Linear in its weights. With a Gaussian prior on them it is a Gaussian process:
    far from the centres the force is zero and its uncertainty that of the prior.

    Attributes:
        weights: $w_j$ [L T⁻²], what trains.
        centers: $c_j$ [L]; fixed.
        width: $b$ [L], positive; fixed.

    Raises:
        InputError: shapes disagree, or `width` is a number <= 0.
    """

    weights: Float[Array, "kernel dim"]
    centers: Float[Array, "kernel dim"]
    width: Scalar

    def __check_init__(self):
        check_kernels(self, np.shape(self.centers))

    @property
    def parameters(self):
        return self.weights

    def __call__(self, t, x, v):
        return kernel_values(x, self.centers, self.width) @ self.weights


class KernelPotential(AbstractLearnedForce):
    r"""Conservative force $-\nabla U$, $U(x) = \sum_j w_j \exp(-|x - c_j|^2 / 2 b^2)$.

    Attributes:
        weights: $w_j$ [L² T⁻²], what trains.
        centers: $c_j$ [L]; fixed.
        width: $b$ [L], positive; fixed.

    Raises:
        InputError: shapes disagree, or `width` is a number <= 0.
    """

    weights: Float[Array, " kernel"]
    centers: Float[Array, "kernel dim"]
    width: Scalar

    def __check_init__(self):
        check_kernels(self, np.shape(self.centers)[:1])

    @property
    def parameters(self):
        return self.weights

    def potential(self, t: Scalar, x: Float[Array, " dim"]) -> Float[Array, ""]:
        """Potential energy per mass $U(x)$ [L² T⁻²]."""
        return self.weights @ kernel_values(x, self.centers, self.width)

    def __call__(self, t, x, v):
        strengths = self.weights * kernel_values(x, self.centers, self.width)
        return strengths @ (x[None] - self.centers) / self.width**2


def kernel_centers(
    positions: Float[np.ndarray, "sample dim"], *, spacing: float, margin: float
) -> Float[np.ndarray, "kernel dim"]:
    """Points of a square grid that lie within `margin` of an observed position.

    Args:
        positions: observed positions [L].
        spacing: of the grid [L], positive.
        margin: distance from the data [L] up to which there are kernels, positive.

    Raises:
        InputError: `spacing` or `margin` is not positive.
    """
    for name, value in (("spacing", spacing), ("margin", margin)):
        if not value > 0:
            raise InputError(f"kernel_centers {name}: expected > 0, got {value}")
    from scipy.spatial import KDTree

    low, high = positions.min(axis=0) - margin, positions.max(axis=0) + margin
    axes = [np.arange(a, b + spacing, spacing) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    points = grid.reshape(-1, positions.shape[1])
    return points[KDTree(positions).query(points)[0] < margin]


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


def kernel_values(
    x: Float[Array, " dim"], centers: Float[Array, "kernel dim"], width: Scalar
) -> Float[Array, " kernel"]:
    r"""Radial basis functions $\exp(-|x - c_j|^2 / 2 b^2)$ at one point."""
    offsets = (x[None] - centers) / width
    return jnp.exp(-0.5 * jnp.sum(offsets**2, axis=1))


def check_kernels(force: Any, expected: tuple[int, ...]) -> None:
    """Raise `InputError` where its weights have not the shape `expected`."""
    name = type(force).__name__
    if np.shape(force.weights) != expected:
        raise InputError(
            f"{name}.weights: expected shape {expected}, as the centers have, got "
            f"{np.shape(force.weights)}"
        )
    if isinstance(force.width, float | int) and force.width <= 0:
        raise InputError(f"{name}.width: expected > 0, got {force.width}")
