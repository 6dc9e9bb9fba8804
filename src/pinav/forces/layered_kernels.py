"""A potential whose kernels are finer in some places than in others."""

import functools

from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar, Vector
from pinav.errors import InputError
from pinav.forces.force import AbstractLearnedForce
from pinav.forces.kernels import KernelPotential
from pinav.forces.priors import AbstractPrior, Centers, MixturePrior


class LayeredPotential(AbstractLearnedForce):
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
    def parameters(self) -> PyTree:
        return tuple(layer.weights for layer in self.layers)

    @property
    def dim(self) -> int:
        return self.layers[0].dim

    @property
    def is_conservative(self) -> bool:
        return True

    def prior(self) -> AbstractPrior:
        return functools.reduce(MixturePrior, (layer.prior() for layer in self.layers))

    def kernels_on(self, centers: Centers, width: float) -> KernelPotential:
        return KernelPotential.with_zero_weights(centers, width)

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        """Potential energy per mass $U(x)$ [L² T⁻²]."""
        return sum(
            (layer.potential(t, x) for layer in self.layers[1:]),
            self.layers[0].potential(t, x),
        )

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return sum(
            (layer(t, x, v) for layer in self.layers[1:]), self.layers[0](t, x, v)
        )
