"""Drag: linear, by a tensor, and relative to a flow."""

from pinav.arguments import Scalar, Vector
from pinav.errors import InputError
from pinav.forces.flows import AbstractFlow
from pinav.forces.force import AbstractForce
from pinav.forces.tensors import AbstractTensorField


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

    tensor: AbstractTensorField

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return -self.tensor(x, v)


class InFlow(AbstractForce):
    """A force that sees the velocity relative to the fluid: a drag in a current.

    Attributes:
        force: such as `LinearDrag`.
        flow: the velocity of the fluid.
    """

    force: AbstractForce
    flow: AbstractFlow

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.force(t, x, v - self.flow(t, x))


class Advection(AbstractForce):
    """What a current does to a swimmer without inertia whose mobility is 1.

    As an environment it makes the current what is unknown; as the flow of an
    `OverdampedSwimmer` it would be known.

    Attributes:
        flow: the velocity of the fluid.
    """

    flow: AbstractFlow

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.flow(t, x)
