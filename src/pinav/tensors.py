"""Positive tensors that vary in space: mobilities and drags.

A tensor is a linear map, so that an isotropic one needs no matrix and serves any
dimension.
"""

import abc

import equinox as eqx
from jaxtyping import Array, Float

from pinav.actuation import Scalar
from pinav.errors import InputError


class AbstractTensorField(eqx.Module):
    """A symmetric positive tensor at each position. No batch axis."""

    @abc.abstractmethod
    def __call__(
        self, x: Float[Array, " dim"], vector: Float[Array, " dim"]
    ) -> Float[Array, " dim"]:
        """The tensor at position `x` [L] applied to a vector."""


class IsotropicTensor(AbstractTensorField):
    """A multiple of the identity, the same everywhere.

    Attributes:
        value: the factor, positive.

    Raises:
        InputError: `value` is a number <= 0.
    """

    value: Scalar

    def __check_init__(self):
        if isinstance(self.value, float | int) and self.value <= 0:
            raise InputError(f"IsotropicTensor.value: expected > 0, got {self.value}")

    def __call__(self, x, vector):
        return self.value * vector


def as_tensor(value: AbstractTensorField | Scalar) -> AbstractTensorField:
    """A number as an isotropic tensor; a tensor as it is."""
    if isinstance(value, AbstractTensorField):
        return value
    return IsotropicTensor(value)
