r"""A force as a sum of terms with a structure and a free remainder.

A term is $F(x) = \sum_m f(z_m(x))\, \nabla z_m$ with coordinates $z_m$ that depend on
few numbers (a centre, an angle, the ends of a segment), its geometry, and a profile
$f(z) = \sum_j w_j\, k(z - \rho_j)$ of Gaussian kernels. It is the profile of the force,
not of the potential: where there are no data its mean is no force. A rotational term
is turned by a right angle, which makes a stream function of the potential. Where $z$ is
a distance the profile is odd in it, so that the force vanishes at distance zero.

References:
    Duvenaud, Nickisch and Rasmussen, NeurIPS 2011, additive processes; van der Wilk,
    Bauer, John and Hensman, NeurIPS 2018, invariances by the marginal likelihood.
"""

import abc
import dataclasses
from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar, Vector, dimension_of
from pinav.errors import InputError
from pinav.forces.fitted_laws import FittedLaw
from pinav.forces.force import (
    AbstractForce,
    AbstractLearnedForce,
    HelmholtzParts,
    KernelPlaces,
)
from pinav.forces.kernel_mixtures import KernelMixture
from pinav.forces.kernels import KernelForce, KernelPotential, quarter_turn
from pinav.forces.priors import (
    AbstractPrior,
    Centers,
    DistancePrior,
    IsotropicPrior,
    MixturePrior,
    ProfilePrior,
)

Places = Float[Array, " kernel"]
"""Places of the kernels of a profile [L]."""


SMALL, LEAST, MOST = -6.0, -12.0, -1.5
"""Logarithm of the amplitude of what stands beside terms, or of kernels beside a law,
relative to theirs: at the start of a search; the lowest, since it must be able to
vanish; and the highest, since without a bound what is free may be all there is, and
then neither the geometry of a term nor the numbers of a law are determined."""

FAR = 10.0
"""Reach of a law, in its own sizes."""

ROUNDING = 0.05
"""Distance, in widths of a kernel, within which the distance to a point is rounded.

At the point itself its derivative does not exist. Where the slope of a potential is not
zero there, as about the centre of a wide ring, steps of a fit would go to and fro
across the point. A hill that follows the law `hill` remains one when it is rounded."""


class AbstractTerm(AbstractForce):
    """A part of a force that is linear in its weights, given its geometry.

    Attributes:
        weights: with a Gaussian prior.
        rotational: True if the force is turned by a right angle.
        kinds: the word for it in tables, as it is and, where that differs, turned.
        formulas: its formula, as it is and, where that differs, turned.
        shaped_by: fields that shape it, each with a wide prior.
    """

    weights: eqx.AbstractVar[Float[Array, " weight"]]
    rotational: eqx.AbstractVar[bool]
    kinds: ClassVar[tuple[str, ...]]
    formulas: ClassVar[tuple[str, ...]]
    shaped_by: ClassVar[tuple[str, ...]] = ()

    @property
    def kind(self) -> str:
        """The word for it in tables."""
        return self.kinds[-1 if self.rotational else 0]

    @property
    def latex(self) -> str:
        """Its formula."""
        return self.formulas[-1 if self.rotational else 0]

    @property
    def placement(self) -> PyTree:
        """The numbers that shape its coordinates."""
        return tuple(getattr(self, name) for name in self.shaped_by)

    @property
    def dimensions(self) -> tuple[str, ...]:
        """The dimension of each number of the placement, as its field states it."""
        sizes = ((name, np.size(getattr(self, name))) for name in self.shaped_by)
        return tuple(dimension_of(self, name) for name, n in sizes for _ in range(n))

    @property
    def geometry(self) -> PyTree:
        """The numbers that shape it, each with a wide prior."""
        return self.placement

    @property
    @abc.abstractmethod
    def geometry_scales(self) -> tuple[float, ...]:
        """Prior standard deviation of each leaf of the geometry.

        Unbounded, a negligible term could have any geometry, and the integral over all
        of them would count in its favour.
        """

    @property
    @abc.abstractmethod
    def force_per_weight(self) -> float:
        """About what force a weight of one makes: of energies [L⁻¹], of forces 1."""

    @abc.abstractmethod
    def prior(self) -> AbstractPrior:
        """Prior of the weights."""

    @abc.abstractmethod
    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        """Potential energy per mass, or the stream function of a rotational term."""

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        force = -jax.grad(self.potential, argnums=1)(t, x)
        return quarter_turn(force) if self.rotational else force


def prior_of(terms: Sequence[AbstractTerm]) -> AbstractPrior:
    """Prior of several terms, independent of each other."""
    first, *others = terms
    whole = first.prior()
    for term in others:
        unit = first.force_per_weight / term.force_per_weight
        whole = MixturePrior(whole, term.prior(), unit=unit)
    return whole


class AbstractProfileTerm(AbstractTerm):
    """A term with a profile of one coordinate, or of several that share it.

    Where its potential follows a law, the first weight is the height of that [L² T⁻²],
    before those of the kernels.

    Attributes:
        places: of the kernels in the coordinate [L]; fixed.
        width: of a kernel [L]; fixed.
        law: that the potential follows beside the kernels, if any.
    """

    places: eqx.AbstractVar[Places]
    width: eqx.AbstractVar[Scalar]
    law: eqx.AbstractVar[FittedLaw | None]

    is_odd: ClassVar[bool] = True
    """True if the profile is odd, as a distance asks for."""

    @property
    def placement_scales(self) -> tuple[float, ...]:
        """Prior standard deviation of each number of the placement."""
        dimensions = (dimension_of(self, name) for name in self.shaped_by)
        return tuple(self.reach if one == "L" else 1.0 for one in dimensions)

    @property
    def geometry(self) -> PyTree:
        return (*self.placement, *(self.law.numbers if self.law else ()))

    @property
    def geometry_scales(self) -> tuple[float, ...]:
        return (*self.placement_scales, *(self.law.scales if self.law else ()))

    @property
    def offset(self) -> Scalar:
        """Origin of the coordinate, along it, from the origin of space [L]."""
        return 0.0

    @abc.abstractmethod
    def coordinates(self, x: Vector) -> Float[Array, " coordinate"]:
        """The coordinates that share the profile [L]."""

    def profile(self, z: Scalar) -> Float[Array, ""]:
        """The force along the coordinate at `z` [L T⁻²]."""
        values = jnp.exp(-0.5 * ((z - self.places) / self.width) ** 2)
        if self.is_odd:
            values = values - jnp.exp(-0.5 * ((z + self.places) / self.width) ** 2)
        if self.law is None:
            return values @ self.weights
        return self.weights[0] * self.law.force(z) + values @ self.weights[1:]

    @property
    def reach(self) -> float:
        """Distance of the farthest kernel from the term [L]; of a law, if alone."""
        if self.law is not None and not self.has_kernels:
            return FAR * float(self.law.size)
        return float(np.max(np.abs(self.places)))

    @property
    def has_kernels(self) -> bool:
        """True if there are kernels, beside a law or without one."""
        return len(self.places) > 0

    @property
    def force_per_weight(self) -> float:
        return 1.0 if self.law is None else 1 / float(self.law.size)

    def prior(self) -> AbstractPrior:
        if not self.has_kernels:
            return IsotropicPrior(1)
        base = ProfilePrior(self.places, self.width)
        kernels = DistancePrior(base) if self.is_odd else base
        if self.law is None:
            return kernels
        height, unit = IsotropicPrior(1), self.force_per_weight
        return MixturePrior(height, kernels, SMALL, LEAST, MOST, unit)

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        def height(z: Scalar) -> Float[Array, ""]:
            scale = self.width * np.sqrt(np.pi / 2)
            erf = jax.scipy.special.erf
            root = np.sqrt(2.0) * self.width
            rise = erf((z - self.places) / root) + erf(self.places / root)
            if self.is_odd:
                mirrored = erf((z + self.places) / root) - erf(self.places / root)
                rise = rise - mirrored
            if self.law is None:
                return -scale * (rise @ self.weights)
            height = self.weights[0] * self.law.potential(z)
            return height - scale * (rise @ self.weights[1:])

        return jnp.sum(jax.vmap(height)(self.coordinates(x)))

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        z, pull = jax.vjp(self.coordinates, x)
        (force,) = pull(jax.vmap(self.profile)(z))
        return quarter_turn(force) if self.rotational else force


def distance(offset: Vector, rounding: Scalar) -> Float[Array, ""]:
    """Length of a vector, smooth at zero."""
    return jnp.sqrt(offset @ offset + rounding**2)


def exponential_of_shear(p: Scalar, q: Scalar) -> Float[Array, "2 2"]:
    r"""$e^S$ of the traceless symmetric matrix of the entries $p$ and $q$."""
    size = jnp.sqrt(p**2 + q**2 + 1e-12)  # smooth where there is no shear
    shear = jnp.stack([jnp.stack([p, q]), jnp.stack([q, -p])])
    return jnp.cosh(size) * jnp.eye(2) + jnp.sinh(size) / size * shear


Remainder = KernelPotential | KernelForce | KernelMixture
"""Free kernels beside structured terms."""


class StructuredForce(AbstractLearnedForce):
    r"""Force $\sum_i F_i(x) + F_{\mathrm{free}}(x)$: terms and a rest.

    The remainder carries what the terms cannot. Its amplitude is a choice of the
    evidence, which sends it to nothing where the terms explain the data, and which
    keeps the band honest where they do not.

    Raises:
        InputError: there are no terms, or one is rotational outside of the plane.
    """

    terms: tuple[AbstractTerm, ...]
    remainder: Remainder

    def __check_init__(self) -> None:
        if not self.terms:
            raise InputError("StructuredForce.terms: expected one or more, got none")
        turning = [term for term in self.terms if term.rotational]
        if turning and self.dim != 2:
            raise InputError(
                f"{type(turning[0]).__name__}.rotational: expected a plane, got "
                f"dimension {self.dim}"
            )

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

    def kernels_on(self, centers: Centers, width: float) -> "StructuredForce":
        """The terms stay as they are."""
        remainder = self.remainder.kernels_on(centers, width)
        return dataclasses.replace(self, remainder=remainder)

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
