"""A learned force that is a sum of structured terms and a free remainder."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar, Vector
from pinav.errors import InputError
from pinav.forces.force import (
    AbstractForce,
    AbstractLearnedForce,
    HelmholtzParts,
    KernelPlaces,
)
from pinav.forces.kernel_mixtures import KernelMixture
from pinav.forces.kernels import KernelForce, KernelPotential
from pinav.forces.priors import Centers, MixturePrior, Shape
from pinav.forces.structures import (
    LEAST,
    MOST,
    SMALL,
    AbstractTerm,
    check_rotation,
    prior_of,
)

Remainder = KernelPotential | KernelForce | KernelMixture
"""Free kernels beside structured terms."""


class StructuredForce(AbstractLearnedForce):
    r"""Force $\sum_i F_i(x) + F_{\mathrm{free}}(x)$: terms and a rest.

    The remainder carries what the terms cannot. Its amplitude is a choice of the
    evidence, which sends it to nothing where the terms explain the data, and which
    keeps the band honest where they do not.

    Attributes:
        terms: with structure, one or more.
        remainder: free kernels.

    Raises:
        InputError: there are no terms, or one is rotational outside of the plane.
    """

    terms: tuple[AbstractTerm, ...]
    remainder: Remainder

    def __check_init__(self) -> None:
        if not self.terms:
            raise InputError("StructuredForce.terms: expected one or more, got none")
        for term in self.terms:
            check_rotation(term, self.dim)

    @property
    def parameters(self) -> PyTree:
        rest = self.remainder.parameters
        rest = rest if isinstance(rest, tuple) else (rest,)
        return (*(term.weights for term in self.terms), *rest)

    @property
    def kind(self) -> str:
        return " + ".join(part.kind for part in (*self.terms, self.remainder))

    @property
    def geometry(self) -> PyTree:
        return tuple(leaf for term in self.terms for leaf in term.geometry)

    @property
    def geometry_scales(self) -> tuple[float, ...]:
        return tuple(scale for term in self.terms for scale in term.geometry_scales)

    @property
    def is_conservative(self) -> bool:
        turning = any(term.rotational for term in self.terms)
        return self.remainder.is_conservative and not turning

    @property
    def helmholtz(self) -> HelmholtzParts | None:
        """Of the remainder."""
        return self.remainder.helmholtz

    @property
    def kernels(self) -> KernelPlaces:
        return self.remainder.kernels

    @property
    def dim(self) -> int:
        return self.remainder.dim

    def prior(self) -> MixturePrior:
        unit = self.terms[0].force_per_weight / self.remainder.force_per_weight
        terms, rest = prior_of(self.terms), self.remainder.prior().broad
        return MixturePrior(terms, rest, SMALL, LEAST, MOST, unit)

    def variance_beyond(
        self, shape: Shape, positions: Float[np.ndarray, "point dim"]
    ) -> Float[np.ndarray, "point dim"]:
        """Of the remainder."""
        _, rest, ratio = self.prior().split(shape)
        return ratio**2 * self.remainder.variance_beyond(rest, positions)

    def draw_beyond(
        self, shape: Shape, amplitude: float, generator: np.random.Generator
    ) -> list[AbstractForce]:
        """Of the remainder."""
        _, rest, ratio = self.prior().split(shape)
        return self.remainder.draw_beyond(rest, ratio * amplitude, generator)

    def kernels_on(self, centers: Centers, width: float) -> "StructuredForce":
        """The terms stay as they are."""
        return eqx.tree_at(
            lambda force: force.remainder,
            self,
            self.remainder.kernels_on(centers, width),
        )

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        """Potential energy per mass $U(x)$ [L² T⁻²].

        Raises:
            InputError: a term is rotational, or the remainder has no potential.
        """
        if not (self.is_conservative and isinstance(self.remainder, KernelPotential)):
            raise InputError(
                "StructuredForce.potential: expected conservative terms and a "
                "KernelPotential, got a rotational part"
            )
        heights = [term.potential(t, x) for term in self.terms]
        return sum(heights, self.remainder.potential(t, x))

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return sum((term(t, x, v) for term in self.terms), self.remainder(t, x, v))


def split_structure(
    force: AbstractForce,
) -> tuple[tuple[AbstractTerm, ...], AbstractForce]:
    """The structured terms of a force, and what there is beside them."""
    if isinstance(force, StructuredForce):
        return force.terms, force.remainder
    return (), force
