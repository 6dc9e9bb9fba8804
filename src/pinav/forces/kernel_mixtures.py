"""Kernel environments of several parts, and those that change with time.

A mixture holds a stream function beside a potential, for the rotational part of a
planar force; splines in time let a potential change.
"""

import abc
import functools
import operator

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar, Vector
from pinav.errors import InputError
from pinav.forces.force import (
    AbstractLearnedForce,
    HelmholtzParts,
    KernelPlaces,
)
from pinav.forces.kernels import (
    KernelPotential,
    KernelStream,
    check_kernels,
    kernel_values,
)
from pinav.forces.priors import (
    ABSENT,
    AbstractPrior,
    Centers,
    MixturePrior,
    Shape,
    TimedPrior,
    WeightPrior,
)


class AbstractKernelSum(AbstractLearnedForce):
    """A sum of learned forces, whose weights are independent of each other."""

    @property
    @abc.abstractmethod
    def parts(self) -> tuple[AbstractLearnedForce, ...]:
        """The forces that add up."""

    @property
    def parameters(self) -> PyTree:
        return tuple(part.parameters for part in self.parts)

    @property
    def dim(self) -> int:
        return self.parts[0].dim

    @property
    def is_static(self) -> bool:
        return all(part.is_static for part in self.parts)

    @property
    def is_conservative(self) -> bool:
        return all(part.is_conservative for part in self.parts)

    def prior(self) -> AbstractPrior:
        return functools.reduce(MixturePrior, (part.prior() for part in self.parts))

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return functools.reduce(operator.add, (part(t, x, v) for part in self.parts))


class KernelMixture(AbstractKernelSum):
    r"""Force with a gradient and a rotational part, $-\nabla U + \nabla^\perp \psi$.

    Every planar force is such a sum (Helmholtz). A harmonic field has both forms: on a
    bounded ground the split is that of the smallest weights.

    References:
        Helmholtz, J. reine angew. Math. 55, 25 (1858).
    """

    gradient: KernelPotential
    rotation: KernelStream

    @classmethod
    def with_zero_weights(cls, centers: Centers, width: float) -> "KernelMixture":
        """Both parts without weight yet: kernels at places, of a width [L]."""
        gradient = KernelPotential.with_zero_weights(centers, width)
        return cls(gradient, KernelStream.with_zero_weights(centers, width))

    @property
    def parts(self) -> tuple[KernelPotential, KernelStream]:
        return self.gradient, self.rotation

    @property
    def kind(self) -> str:
        return "kernel-mixture"

    @property
    def helmholtz(self) -> HelmholtzParts:
        return HelmholtzParts(self.gradient, self.rotation)

    @property
    def kernels(self) -> KernelPlaces:
        return self.gradient.kernels

    def length_scales(self, shape: Shape) -> list[float]:
        first, second, _ = self.prior().split(shape)
        parts = [] if shape[-1] > ABSENT else self.gradient.length_scales(first)
        if shape[-1] > -ABSENT:
            parts = parts + self.rotation.length_scales(second)
        return parts

    @property
    def force_per_weight(self) -> float:
        return self.gradient.force_per_weight

    def prior(self) -> MixturePrior:
        return MixturePrior(self.gradient.prior(), self.rotation.prior())

    def kernels_on(self, centers: Centers, width: float) -> "KernelMixture":
        return KernelMixture.with_zero_weights(centers, width)


class TimedKernelPotential(AbstractLearnedForce):
    r"""Force $-\nabla U$ from a potential that changes with time.

    $U(t, x) = \sum_{jk} w_{jk}\, \phi_j(x)\, B_k(t)$ with Gaussians $\phi_j$ in space
    and uniform cubic B-splines in time. Their sum is one: weights that do not depend on
    $k$ make a static `KernelPotential`. Before the first time and after the last the
    potential is that of these times.

    Attributes:
        weights: $w_{jk}$ [L² T⁻²], what trains; three splines more than intervals.
        first: time [T] at which the splines begin; fixed.
        last: time [T] at which they end; fixed.

    Raises:
        InputError: shapes disagree, `width` is a number <= 0, or `last` is not after
            `first`.

    References:
        de Boor, A Practical Guide to Splines (1978).
    """

    weights: Float[Array, "kernel spline"]
    centers: Float[Array, "kernel dim"]
    width: Scalar
    first: Scalar
    last: Scalar

    def __check_init__(self) -> None:
        count = max(np.shape(self.weights)[-1], 4)
        check_kernels(self, (*np.shape(self.centers)[:1], count))
        times = self.first, self.last
        if all(isinstance(t, float | int) for t in times) and not times[0] < times[1]:
            raise InputError(
                f"TimedKernelPotential: expected last > first, got {self.last} and "
                f"{self.first}"
            )

    @property
    def parameters(self) -> PyTree:
        return self.weights

    @property
    def dim(self) -> int:
        return self.centers.shape[1]

    @property
    def is_static(self) -> bool:
        return False

    def prior(self) -> TimedPrior:
        return TimedPrior(WeightPrior(self.centers, self.width), self.weights.shape[1])

    def kernels_on(self, centers: Centers, width: float) -> KernelPotential:
        return KernelPotential.with_zero_weights(centers, width)

    def splines(self, t: Scalar) -> Float[Array, " spline"]:
        """Value of each spline at time `t` [T]."""
        count = self.weights.shape[1]
        dtype = self.weights.dtype
        fraction = (jnp.asarray(t, dtype) - self.first) / (self.last - self.first)
        place = jnp.clip(fraction, 0.0, 1.0) * (count - 3)
        return cubic_spline(place - jnp.arange(-1, count - 1, dtype=dtype))

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        """Potential energy per mass $U(t, x)$ [L² T⁻²]."""
        values = kernel_values(x, self.centers, self.width)
        return values @ self.weights @ self.splines(t)

    def at(self, t: Scalar) -> KernelPotential:
        """The static potential that it is at time `t` [T]."""
        return KernelPotential(self.weights @ self.splines(t), self.centers, self.width)

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.at(t)(t, x, v)


class ChangingPotential(AbstractKernelSum):
    r"""Force $-\nabla (U_0(x) + U_1(t, x))$: what stays, and what changes.

    Where nothing changes $U_1 = 0$ leaves a `KernelPotential` on a grid as fine as it
    needs, while that of the change, which has many more weights, may be coarser.
    """

    static: KernelPotential
    change: TimedKernelPotential

    @property
    def parts(self) -> tuple[KernelPotential, TimedKernelPotential]:
        return self.static, self.change

    @property
    def kernels(self) -> KernelPlaces:
        return self.static.kernels

    def length_scales(self, shape: Shape) -> list[float]:
        return [] if shape[-1] > ABSENT else self.static.length_scales(shape)

    def kernels_on(self, centers: Centers, width: float) -> "ChangingPotential":
        """The part that changes with time stays as it is."""
        return ChangingPotential(
            KernelPotential.with_zero_weights(centers, width), self.change
        )

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        """Potential energy per mass $U(t, x)$ [L² T⁻²]."""
        return self.static.potential(t, x) + self.change.potential(t, x)


def cubic_spline(offsets: Float[Array, " spline"]) -> Float[Array, " spline"]:
    """The uniform cubic B-spline about zero, with knots at the integers -2 to 2."""
    far = jnp.abs(offsets)
    inner = 2 / 3 - far**2 + far**3 / 2
    outer = jnp.maximum(2 - far, 0.0) ** 3 / 6
    return jnp.where(far < 1, inner, outer)


class LayeredPotential(AbstractKernelSum):
    r"""Conservative force $-\sum_l \nabla U_l$ of layers of kernels of several widths.

    A hill with sharp flanks and a long tail needs narrow kernels where it is steep and
    wide ones far away: one width for both would take thousands.

    Attributes:
        layers: $U_l$, from wide kernels to narrow ones, one or more.

    Raises:
        InputError: there are no layers, or they are not in the same space.

    References:
        Floater and Iske, J. Comput. Appl. Math. 73, 65 (1996).
    """

    layers: tuple[KernelPotential, ...]

    def __check_init__(self) -> None:
        if len({layer.dim for layer in self.layers}) != 1:
            raise InputError(
                "LayeredPotential.layers: expected one or more, of one dimension, got "
                f"{[layer.dim for layer in self.layers]}"
            )

    @property
    def parts(self) -> tuple[KernelPotential, ...]:
        return self.layers

    def kernels_on(self, centers: Centers, width: float) -> KernelPotential:
        return KernelPotential.with_zero_weights(centers, width)

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        """Potential energy per mass $U(x)$ [L² T⁻²]."""
        heights = (layer.potential(t, x) for layer in self.layers)
        return functools.reduce(operator.add, heights)
