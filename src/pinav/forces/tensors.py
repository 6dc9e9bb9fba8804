"""Positive tensors that vary in space, and the drags that they make.

A tensor is a linear map, so that an isotropic one needs no matrix and serves any
dimension. Where it has a director, the plane is meant.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import (
    Scalar,
    Vector,
    check_positive,
    dimension,
    point,
    refuse_text,
)
from pinav.errors import InputError
from pinav.forces.flows import AbstractFlow
from pinav.forces.force import AbstractForce
from pinav.forces.kernels import kernel_values


class AbstractTensorField(eqx.Module):
    """A symmetric positive tensor at each position. No batch axis."""

    def __check_init__(self) -> None:
        refuse_text(self)

    @abc.abstractmethod
    def __call__(self, x: Vector, vector: Vector) -> Vector:
        """The tensor at position `x` [L] applied to a vector."""

    @abc.abstractmethod
    def factor(self, x: Vector, vector: Vector) -> Vector:
        r"""A factor $L$ with $L L^\top$ = the tensor at `x`, applied to a vector."""


class IsotropicTensor(AbstractTensorField):
    """A multiple of the identity, the same everywhere.

    Raises:
        InputError: `value` is a number <= 0.
    """

    value: Scalar

    def __check_init__(self) -> None:
        check_positive(self, "value")

    def __call__(self, x: Vector, vector: Vector) -> Vector:
        return self.value * vector

    def factor(self, x: Vector, vector: Vector) -> Vector:
        return jnp.sqrt(self.value) * vector


class AbstractDirector(eqx.Module):
    """Direction of the fibres of a medium in the plane; its sign is without effect."""

    @abc.abstractmethod
    def __call__(self, x: Float[Array, "2"]) -> Float[Array, ""]:
        """Angle to the x axis [rad] at position `x` [L]."""


class ConstantDirector(AbstractDirector):
    """The same direction everywhere.

    Attributes:
        angle: angle to the x axis [rad].
    """

    angle: Scalar = eqx.field(metadata=dimension("rad"))

    def __call__(self, x: Float[Array, "2"]) -> Float[Array, ""]:
        return jnp.asarray(self.angle, x.dtype)


class WavyDirector(AbstractDirector):
    r"""Direction that sways, $\varphi(x) = \varphi_0 + A \sin(k \cdot x)$.

    Attributes:
        angle: mean angle $\varphi_0$ [rad].
        amplitude: $A$ [rad]; zero is a `ConstantDirector`.
        wavevector: $k$ [rad L⁻¹].

    Raises:
        InputError: `wavevector` has not two components.
    """

    angle: Scalar = eqx.field(metadata=dimension("rad"))
    amplitude: Scalar = eqx.field(metadata=dimension("rad"))
    wavevector: Float[Array, "2"] = eqx.field(
        metadata=dimension("rad L-1"), converter=point("WavyDirector.wavevector", 2)
    )

    def __call__(self, x: Float[Array, "2"]) -> Float[Array, ""]:
        return self.angle + self.amplitude * jnp.sin(self.wavevector @ x)


class UniaxialTensor(AbstractTensorField):
    r"""Tensor $c_\parallel n n^\top + c_\perp (I - n n^\top)$ in the plane.

    Attributes:
        along: $c_\parallel$, its value along the director, positive.
        across: $c_\perp$, its value across the director, positive.
        director: direction $n(x)$ of the fibres.

    Raises:
        InputError: a principal value is a number <= 0.

    References:
        Happel and Brenner, Low Reynolds Number Hydrodynamics.
    """

    along: Scalar
    across: Scalar
    director: AbstractDirector

    def __check_init__(self) -> None:
        check_positive(self, "along", "across")

    def __call__(self, x: Vector, vector: Vector) -> Vector:
        return self._apply(self.along, self.across, x, vector)

    def factor(self, x: Vector, vector: Vector) -> Vector:
        return self._apply(jnp.sqrt(self.along), jnp.sqrt(self.across), x, vector)

    def _apply(
        self, along: Scalar, across: Scalar, x: Vector, vector: Vector
    ) -> Vector:
        angle = self.director(x)
        axis = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        return across * vector + (along - across) * (axis @ vector) * axis


class CholeskyTensor(AbstractTensorField):
    r"""Tensor $L L^\top$, the same everywhere: positive whatever its numbers are.

    The parametrisation to train: unlike principal values and an angle it has no
    singular point where the tensor is isotropic.

    Attributes:
        log_diagonal: logarithms of the diagonal of $L$.
        below: entries of $L$ below its diagonal, row by row.
    """

    log_diagonal: Vector
    below: Float[Array, " pair"]

    @classmethod
    def of(cls, matrix: Float[Array, "dim dim"]) -> "CholeskyTensor":
        """The tensor of a matrix.

        Raises:
            InputError: the matrix is not symmetric and positive.
        """
        values = np.asarray(matrix)
        if not np.allclose(values, values.T) or np.linalg.eigvalsh(values)[0] <= 0:
            raise InputError(
                "CholeskyTensor.of: expected a symmetric positive matrix, got "
                f"{values.tolist()}"
            )
        lower = jnp.linalg.cholesky(matrix)
        rows, columns = np.tril_indices(len(values), -1)
        return cls(jnp.log(jnp.diagonal(lower)), lower[rows, columns])

    def lower(self) -> Float[Array, "dim dim"]:
        """$L$."""
        rows, columns = np.tril_indices(self.log_diagonal.shape[0], -1)
        return jnp.diag(jnp.exp(self.log_diagonal)).at[rows, columns].set(self.below)

    def __call__(self, x: Vector, vector: Vector) -> Vector:
        return self.lower() @ (self.lower().T @ vector)

    def factor(self, x: Vector, vector: Vector) -> Vector:
        return self.lower() @ vector


class BrinkmanTensor(AbstractTensorField):
    r"""Isotropic drag of a sphere in a porous medium that varies in space.

    $\eta(x) = \eta_0 (1 + \kappa a + (\kappa a)^2 / 9)$ with the inverse screening
    length $\kappa(x) = \sum_j \kappa_j \exp(-|x - c_j|^2 / 2 w^2)$; the permeability
    is $\kappa^{-2}$, so that the fluid is free where $\kappa = 0$.

    Attributes:
        clear: $\eta_0$ in the free fluid, positive.
        radius: $a$ of the swimmer [L].
        screening: $\kappa_j$ [L⁻¹], not negative.
        centers: $c_j$ of the dense regions [L].
        width: $w$ of the dense regions [L], positive.

    Raises:
        InputError: `clear` or `width` is a number <= 0.

    References:
        Brinkman, Appl. Sci. Res. 1, 27 (1949).
    """

    clear: Scalar
    radius: Scalar = eqx.field(metadata=dimension("L"))
    screening: Float[Array, " region"] = eqx.field(metadata=dimension("L-1"))
    centers: Float[Array, "region dim"] = eqx.field(metadata=dimension("L"))
    width: Scalar = eqx.field(metadata=dimension("L"))

    def __check_init__(self) -> None:
        check_positive(self, "clear", "width")

    def value(self, x: Vector) -> Float[Array, ""]:
        r"""$\eta(x)$."""
        bumps = kernel_values(x, self.centers, self.width)
        thickness = self.radius * (self.screening @ bumps)
        return self.clear * (1 + thickness + thickness**2 / 9)

    def __call__(self, x: Vector, vector: Vector) -> Vector:
        return self.value(x) * vector

    def factor(self, x: Vector, vector: Vector) -> Vector:
        return jnp.sqrt(self.value(x)) * vector


def tensor_matrix(tensor: AbstractTensorField, x: Vector) -> Float[Array, "dim dim"]:
    """The matrix of a tensor at position `x` [L]."""
    return jax.vmap(lambda unit: tensor(x, unit), out_axes=1)(
        jnp.eye(x.shape[0], dtype=x.dtype)
    )


def as_tensor(value: AbstractTensorField | Scalar) -> AbstractTensorField:
    """A number as an isotropic tensor; a tensor as it is."""
    if isinstance(value, AbstractTensorField):
        return value
    return IsotropicTensor(value)


class LinearDrag(AbstractForce):
    r"""Viscous drag $-\eta v$.

    Attributes:
        damping: $\eta$ [T⁻¹], not negative.

    Raises:
        InputError: `damping` is a negative number.

    References:
        PI-NAV paper, eq. (2).
    """

    damping: Scalar = eqx.field(metadata=dimension("T-1"))

    def __check_init__(self) -> None:
        if isinstance(self.damping, float | int) and self.damping < 0:
            raise InputError(f"LinearDrag.damping: expected >= 0, got {self.damping}")

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return -self.damping * v


class TensorDrag(AbstractForce):
    r"""Viscous drag $-\Gamma(x) v$ that depends on direction or place.

    A `UniaxialTensor` makes it anisotropic, with a constant or varying director; a
    `BrinkmanTensor` makes it that of a porous medium; a `CholeskyTensor` trains; an
    `IsotropicTensor` is a `LinearDrag`.

    Attributes:
        tensor: $\Gamma$ [T⁻¹].
    """

    tensor: AbstractTensorField = eqx.field(metadata=dimension("T-1"))

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return -self.tensor(x, v)


class InFlow(AbstractForce):
    """A force, such as `LinearDrag`, that sees the velocity relative to the fluid."""

    force: AbstractForce
    flow: AbstractFlow

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.force(t, x, v - self.flow(t, x))


class Advection(AbstractForce):
    """The effect of a current on a swimmer without inertia whose mobility is 1.

    As an environment it makes the current what is unknown; as the flow of an
    `OverdampedSwimmer` it would be known.
    """

    flow: AbstractFlow

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.flow(t, x)
