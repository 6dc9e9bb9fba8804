r"""Forces and tensors made of kernels in coordinates of their own.

`KernelProfile` is a force along some axes that depends on others, or on the same;
`KernelTensor` a positive tensor with the coordinate axes as principal ones.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar, Vector
from pinav.errors import InputError
from pinav.forces.force import AbstractLearnedForce
from pinav.forces.kernel_basis import KernelBasis
from pinav.forces.kernels import KernelForce
from pinav.forces.priors import (
    AbstractPrior,
    Centers,
    MixturePrior,
    StationaryPrior,
)
from pinav.forces.tensors import AbstractTensorField


class KernelProfile(AbstractLearnedForce):
    r"""Force $F_i(x) = \sum_j w_{ji} \phi_j(x)$ along some axes, zero along the others.

    On a ring `along` is (0,) and the basis periodic; above a wall `along` is (2,) and
    the basis that of the height alone. Where a coordinate u(x) is warped there is a
    second part, $s_i(x_i) \sum_j w'_{ji} \phi_j(x)$, with the slope s of u relative to
    that at its origin: a potential in u. The evidence chooses the shares of both.

    Attributes:
        weights: $w_{ji}$, and $w'_{ji}$ below, what trains [F].
        basis: $\phi_j$; fixed.
        along: the components of the force that are learned.
        space: dimension of the positions.

    Raises:
        InputError: shapes disagree, or a component is not there.
    """

    weights: Float[Array, "kernel component"]
    basis: KernelBasis
    along: tuple[int, ...] = eqx.field(static=True)
    space: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        if not self.along or not all(0 <= i < self.space for i in self.along):
            raise InputError(
                "KernelProfile.along: expected one or more components from 0 to "
                f"{self.space - 1}, got {self.along}"
            )
        rows = _num_parts(self.basis) * len(self.basis.centers)
        if self.weights.shape[0] != rows:
            raise InputError(
                f"KernelProfile.weights: expected {rows} rows, one for each kernel and "
                f"part, got {self.weights.shape[0]}"
            )

    @classmethod
    def with_zero_weights(
        cls, basis: KernelBasis, along: tuple[int, ...], space: int
    ) -> "KernelProfile":
        """No force yet."""
        shape = _num_parts(basis) * len(basis.centers), len(along)
        return cls(jnp.zeros(shape), basis, along, space)

    @property
    def parameters(self) -> PyTree:
        return self.weights

    @property
    def dim(self) -> int:
        return self.space

    @property
    def periods(self) -> dict[int, float]:
        axes = self.basis.axes
        return {axis.index: axis.period for axis in axes if axis.period is not None}

    def prior(self) -> AbstractPrior:
        part = StationaryPrior(np.asarray(self.basis.centers), len(self.along))
        return part if _num_parts(self.basis) == 1 else MixturePrior(part, part)

    def kernels_on(self, centers: Centers, width: float) -> KernelForce:
        """A free force: other places have no coordinates of their own."""
        return KernelForce.with_zero_weights(centers, width)

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        values = self.basis(x)
        if _num_parts(self.basis) == 1:
            along = values @ self.weights
        else:
            even, in_potential = jnp.split(self.weights, 2)
            slopes = {axis.index: axis.slope(x[axis.index]) for axis in self.basis.axes}
            one = jnp.ones((), x.dtype)
            scale = jnp.stack([slopes.get(i, one) for i in self.along])
            along = values @ even + scale * (values @ in_potential)
        return jnp.zeros_like(x).at[np.array(self.along)].set(along)


def _num_parts(basis: KernelBasis) -> int:
    # A potential that changes as much from one to two layers above a wall as from ten
    # to twenty pulls far harder near the wall: kernels of one amplitude would flatten
    # it there, and a potential alone a weight, which is the same everywhere.
    return 2 if basis.is_warped else 1


class KernelTensor(AbstractTensorField):
    r"""Tensor $\exp(m_g + \sum_j w_{gj} \phi_j(x))$ along the axes of each group.

    Axes of one group share a process: two groups are what a plane wall asks for,
    (0, 1) parallel to it and (2,) normal to it.

    Attributes:
        levels: $m_g$, logarithms of the tensor's unit.
        weights: $w_{gj}$.
        basis: $\phi_j$.
        groups: the axes of each process.

    Raises:
        InputError: an axis belongs to no group, or to two.
    """

    levels: Float[Array, " group"]
    weights: Float[Array, "group kernel"]
    basis: KernelBasis
    groups: tuple[tuple[int, ...], ...] = eqx.field(static=True)

    def __check_init__(self) -> None:
        check_groups("KernelTensor.groups", self.groups)

    def logarithms(self, x: Vector) -> Float[Array, " group"]:
        """Logarithm of the tensor along the axes of each group."""
        return self.levels + self.weights @ self.basis(x)

    def diagonal(self, x: Vector) -> Vector:
        """The tensor along each axis at a position [L]."""
        return jnp.exp(self.logarithms(x))[self.group_of_axis]

    @property
    def group_of_axis(self) -> np.ndarray:
        """The group to which each axis belongs."""
        pairs = [(axis, g) for g, axes in enumerate(self.groups) for axis in axes]
        return np.array([group for _, group in sorted(pairs)])

    def scale_by(self, factor: float) -> "KernelTensor":
        """The tensor times a positive number."""
        levels = self.levels + jnp.log(jnp.asarray(factor, self.levels.dtype))
        return KernelTensor(levels, self.weights, self.basis, self.groups)

    def __call__(self, x: Vector, vector: Vector) -> Vector:
        return self.diagonal(x) * vector

    def factor(self, x: Vector, vector: Vector) -> Vector:
        return jnp.sqrt(self.diagonal(x)) * vector


def check_groups(name: str, groups: tuple[tuple[int, ...], ...]) -> None:
    """Refuse groups that do not hold every axis once.

    Raises:
        InputError: they do not.
    """
    axes = sorted(axis for group in groups for axis in group)
    if not axes or axes != list(range(len(axes))):
        raise InputError(
            f"{name}: expected every axis from 0 on in one group, such as "
            f"((0, 1), (2,)), got {groups}"
        )
