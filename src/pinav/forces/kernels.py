"""Forces and potentials that are sums of Gaussian kernels."""

import abc
import math
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar, Vector, check_positive, on_device
from pinav.errors import InputError
from pinav.forces.force import (
    AbstractLearnedForce,
    KernelPlaces,
    forces_at,
)
from pinav.forces.priors import Centers, Shape, WeightPrior
from pinav.settings import POSITIVE

Kernels = TypeVar("Kernels", bound="AbstractKernels")


class AbstractKernels(AbstractLearnedForce):
    """Static kernels at places; each class says how their weights make a force.

    Attributes:
        centers: $c_j$ [L]; fixed.
        width: $b$ [L], positive; fixed.

    Raises:
        InputError: shapes disagree, or `width` is a number <= 0.
    """

    weights: eqx.AbstractVar[Float[Array, "kernel ..."]]
    centers: eqx.AbstractVar[Float[Array, "kernel dim"]]
    width: eqx.AbstractVar[Scalar]

    def __check_init__(self) -> None:
        check_kernels(self, self.weight_shape(np.shape(self.centers)))

    @staticmethod
    @abc.abstractmethod
    def weight_shape(centers: tuple[int, ...]) -> tuple[int, ...]:
        """Shape of the weights of kernels whose centres have a shape."""

    @classmethod
    def with_zero_weights(
        cls: type[Kernels], centers: Centers, width: float
    ) -> Kernels:
        """A force without weight yet: kernels at places, of a width [L]."""
        places = on_device(centers)
        weights = on_device(np.zeros(cls.weight_shape(places.shape)))
        return cls(weights, places, width)

    @property
    def parameters(self) -> PyTree:
        return self.weights

    @property
    def dim(self) -> int:
        return self.centers.shape[1]

    @property
    def kernels(self) -> KernelPlaces:
        return KernelPlaces(self.centers, self.width)

    def length_scales(self, shape: Shape) -> list[float]:
        return [float(np.exp(shape[0]))]

    @property
    @abc.abstractmethod
    def force_per_weight(self) -> float:
        """About what force a weight of one makes: of energies [L⁻¹], of forces 1."""

    @classmethod
    def kernel_forces(
        cls, offsets: Float[np.ndarray, "*place dim"], width: float
    ) -> Float[np.ndarray, "*place dim"]:
        """Force of a kernel of weight one at offsets from its centre [L].

        Of a kernel with a weight for each component, that of each of them.
        """
        with jax.enable_x64(new_val=True):
            empty = cls.with_zero_weights(np.zeros((1, offsets.shape[-1])), width)
            one = eqx.tree_at(lambda force: force.weights, empty, empty.weights + 1)
            return np.asarray(forces_at(one, np.zeros(offsets.shape[:-1]), offsets))

    def prior(self) -> WeightPrior:
        # Not from the weights, which are left out of the fixed part of a model.
        components = math.prod(self.weight_shape(self.centers.shape)[1:])
        return WeightPrior(self.centers, self.width, components)

    def kernels_on(self: Kernels, centers: Centers, width: float) -> Kernels:
        return self.with_zero_weights(centers, width)


class KernelForce(AbstractKernels):
    r"""Free force field $F(x) = \sum_j w_j \exp(-|x - c_j|^2 / 2 b^2)$.

    Linear in its weights. With a Gaussian prior on them it is a Gaussian process:
    far from the centres the force is zero and its uncertainty that of the prior.

    Attributes:
        weights: $w_j$ [L T⁻²], what trains.
    """

    weights: Float[Array, "kernel dim"]
    centers: Float[Array, "kernel dim"]
    width: Scalar

    @property
    def kind(self) -> str:
        return "kernel-force"

    @property
    def force_per_weight(self) -> float:
        return 1.0

    @staticmethod
    def weight_shape(centers: tuple[int, ...]) -> tuple[int, ...]:
        return centers

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return kernel_values(x, self.centers, self.width) @ self.weights


class AbstractScalarKernels(AbstractKernels):
    """Kernels with a weight each, of a potential or of a stream function."""

    weights: eqx.AbstractVar[Float[Array, " kernel"]]

    @property
    def force_per_weight(self) -> float:
        return 1 / float(self.width)

    @staticmethod
    def weight_shape(centers: tuple[int, ...]) -> tuple[int, ...]:
        return centers[:1]

    def _descent(self, x: Vector) -> Vector:
        r"""$-\nabla \sum_j w_j \exp(-|x - c_j|^2 / 2 b^2)$ at one point."""
        strengths = self.weights * kernel_values(x, self.centers, self.width)
        ways = strengths[None] * _offsets(x, self.centers)
        return jnp.sum(ways, axis=1) / self.width**2


class KernelPotential(AbstractScalarKernels):
    r"""Conservative force $-\nabla U$, $U(x) = \sum_j w_j \exp(-|x - c_j|^2 / 2 b^2)$.

    Attributes:
        weights: $w_j$ [L² T⁻²], what trains.
    """

    weights: Float[Array, " kernel"]
    centers: Float[Array, "kernel dim"]
    width: Scalar

    @property
    def kind(self) -> str:
        return "kernel-potential"

    @property
    def is_conservative(self) -> bool:
        return True

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        """Potential energy per mass $U(x)$ [L² T⁻²]."""
        return self.weights @ kernel_values(x, self.centers, self.width)

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self._descent(x)


class KernelStream(AbstractScalarKernels):
    r"""Rotational force $(\partial_y \psi, -\partial_x \psi)$ in the plane.

    With $\psi(x) = \sum_j w_j \exp(-|x - c_j|^2 / 2 b^2)$: it has no divergence, and no
    potential.

    Attributes:
        weights: $w_j$ [L² T⁻²], what trains.

    Raises:
        InputError: the space is not a plane.
    """

    weights: Float[Array, " kernel"]
    centers: Float[Array, "kernel dim"]
    width: Scalar

    def __check_init__(self) -> None:
        if np.shape(self.centers)[1:] != (2,):
            raise InputError(
                "KernelStream.centers: expected points in the plane, shape (n, 2), got "
                f"{np.shape(self.centers)}; choose a KernelForce"
            )

    def stream(self, x: Float[Array, "2"]) -> Float[Array, ""]:
        r"""Stream function $\psi(x)$ [L² T⁻²]; positive turns counter-clockwise."""
        return self.weights @ kernel_values(x, self.centers, self.width)

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return quarter_turn(self._descent(x))


def quarter_turn(force: Float[Array, "2"]) -> Float[Array, "2"]:
    r"""$(\partial_y\psi, -\partial_x\psi)$ of a force that would be $-\nabla\psi$."""
    return jnp.stack([-force[1], force[0]])


def kernel_centers(
    positions: Float[np.ndarray, "sample dim"], *, spacing: float, margin: float
) -> Centers:
    """Points of a square grid that lie within `margin` [L] of an observed position.

    Raises:
        InputError: `spacing` or `margin` is not positive.
    """
    for name, value in (("spacing", spacing), ("margin", margin)):
        POSITIVE.check(f"kernel_centers {name}", float(value))
    from scipy.spatial import KDTree

    low, high = positions.min(axis=0) - margin, positions.max(axis=0) + margin
    axes = [np.arange(a, b + spacing, spacing) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    points = grid.reshape(-1, positions.shape[1])
    # positions on a grid have centers at this very distance, which rounding must not
    # include or leave out
    return points[KDTree(positions).query(points)[0] < (1 - 1e-9) * margin]


def kernel_values(
    x: Vector, centers: Float[Array, "kernel dim"], width: Scalar
) -> Float[Array, " kernel"]:
    r"""Radial basis functions $\exp(-|x - c_j|^2 / 2 b^2)$ at one point."""
    offsets = _offsets(x, centers) / width
    return jnp.exp(-0.5 * jnp.sum(offsets**2, axis=0))


def _offsets(
    x: Vector, centers: Float[Array, "kernel dim"]
) -> Float[Array, "dim kernel"]:
    """The way from each centre to a point [L].

    The kernels come last: a processor then computes several of them at once, in a third
    to a fifth of the time of two or three numbers for each kernel in turn.
    """
    return x[:, None] - centers.T


def check_kernels(force: Any, expected: tuple[int, ...]) -> None:
    """Raise `InputError` where its weights have not the shape `expected`."""
    if np.shape(force.weights) != expected:
        raise InputError(
            f"{type(force).__name__}.weights: expected shape {expected}, as the "
            f"centers have, got {np.shape(force.weights)}"
        )
    check_positive(force, "width")
