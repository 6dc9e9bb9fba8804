"""Forces of potentials with a structure: about a centre, along a line, waves."""

import abc
import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector, check_positive, dimension, point
from pinav.errors import InputError
from pinav.forces.force import AbstractForce, AbstractPotentialForce
from pinav.forces.formulas import NUMERIC, Constants
from pinav.forces.profiles import (
    PROFILES,
    AbstractProfile,
    Gaussian,
    Harmonic,
    InversePower,
    Ring,
    Step,
)
from pinav.forces.profiles import (
    CompactHill as CompactProfile,
)


class AbstractCentralForce(AbstractPotentialForce):
    r"""Force $-\nabla U$ of a profile of the distance from a centre.

    Its fields are the amplitude, the centre [L], and constants that are all positive:
    those of the profile, unless `shapes` says otherwise.
    """

    # The centre is no `AbstractVar`: type checkers would take it for the first field.

    def __check_init__(self) -> None:
        _, _, *positive = dataclasses.fields(self)
        check_positive(self, *(field.name for field in positive))

    @property
    @abc.abstractmethod
    def profile(self) -> AbstractProfile:
        """The profile of its potential."""

    @property
    def shapes(self) -> Constants:
        """Constants of the profile."""
        _, _, *shapes = self._values
        return shapes

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        amplitude, center, *_ = self._values
        offset = x - center
        return amplitude * self.profile.of_square(self.shapes, offset @ offset, NUMERIC)

    @property
    def _values(self) -> list[Any]:
        return [getattr(self, field.name) for field in dataclasses.fields(self)]


class GaussianBarrier(AbstractCentralForce):
    r"""Repulsion $-\nabla U$ from $U(x) = U_0 \exp(-|x - c|^2 / 2\sigma^2)$.

    Attributes:
        height: $U_0$ [L² T⁻²]; negative makes a trap.
        center: $c$ [L].
        width: $\sigma$ [L], positive.

    Raises:
        InputError: `center` is not a point, or `width` is a number <= 0.

    References:
        PI-NAV paper, eq. (1); its centre is (5, 5).
    """

    height: Scalar = eqx.field(metadata=dimension("L2 T-2"))
    center: Vector = eqx.field(
        metadata=dimension("L"), converter=point("GaussianBarrier.center")
    )
    width: Scalar = eqx.field(metadata=dimension("L"))

    @property
    def profile(self) -> Gaussian:
        return Gaussian()


class HarmonicTrap(AbstractCentralForce):
    r"""Pull $-\nabla U$ from $U(x) = k |x - c|^2 / 2$, as of an optical tweezer.

    Attributes:
        stiffness: $k$ [T⁻²]; negative pushes away.
        center: $c$ [L].

    Raises:
        InputError: `center` is not a point.
    """

    stiffness: Scalar = eqx.field(metadata=dimension("T-2"))
    center: Vector = eqx.field(
        metadata=dimension("L"), converter=point("HarmonicTrap.center")
    )

    @property
    def profile(self) -> Harmonic:
        return Harmonic()


class PowerHill(AbstractCentralForce):
    r"""Repulsion $-\nabla U$ from $U(x) = U_0 (1 + |x - c|^2 / s^2)^{-p}$.

    With $p = 1/2$ a screened charge, with $p = 1$ a Lorentzian: tails that no Gaussian
    has.

    Attributes:
        height: $U_0$ [L² T⁻²]; negative makes a trap.
        center: $c$ [L].
        core: $s$ [L], positive.
        exponent: $p$, positive.

    Raises:
        InputError: `center` is not a point, or `core` or `exponent` is a number <= 0.
    """

    height: Scalar = eqx.field(metadata=dimension("L2 T-2"))
    center: Vector = eqx.field(
        metadata=dimension("L"), converter=point("PowerHill.center")
    )
    core: Scalar = eqx.field(metadata=dimension("L"))
    exponent: Scalar

    @property
    def profile(self) -> InversePower:
        return InversePower()

    @property
    def shapes(self) -> Constants:
        return self.core, 2 * self.exponent


class CompactHill(AbstractCentralForce):
    r"""Repulsion $-\nabla U$ from $U(x) = U_0 (1 - |x - c|^2 / R^2)^3$ within $R$.

    Beyond $R$ there is no force; force and gradient are continuous there.

    Attributes:
        height: $U_0$ [L² T⁻²]; negative makes a trap.
        center: $c$ [L].
        radius: $R$ [L], positive.

    Raises:
        InputError: `center` is not a point, or `radius` is a number <= 0.
    """

    height: Scalar = eqx.field(metadata=dimension("L2 T-2"))
    center: Vector = eqx.field(
        metadata=dimension("L"), converter=point("CompactHill.center")
    )
    radius: Scalar = eqx.field(metadata=dimension("L"))

    @property
    def profile(self) -> CompactProfile:
        return CompactProfile()

    @property
    def shapes(self) -> Constants:
        return self.radius, 3.0


class RingBarrier(AbstractCentralForce):
    r"""Repulsion $-\nabla U$ from $U(x) = U_0 \exp(-(|x - c| - \rho)^2 / 2 w^2)$.

    At the very centre the force has no direction; it counts as zero there.

    Attributes:
        height: $U_0$ [L² T⁻²]; negative makes a moat.
        center: $c$ [L].
        radius: $\rho$ [L], positive.
        width: $w$ [L], positive.

    Raises:
        InputError: `center` is not a point, or `radius` or `width` is a number <= 0.
    """

    height: Scalar = eqx.field(metadata=dimension("L2 T-2"))
    center: Vector = eqx.field(
        metadata=dimension("L"), converter=point("RingBarrier.center")
    )
    radius: Scalar = eqx.field(metadata=dimension("L"))
    width: Scalar = eqx.field(metadata=dimension("L"))

    @property
    def profile(self) -> Ring:
        return Ring()


class ProfileBarrier(AbstractPotentialForce):
    r"""Repulsion $-\nabla U$ from any profile about a centre, $U(x) = U_0 L(|x - c|)$.

    Attributes:
        law: name of the profile, such as "Yukawa".
        height: $U_0$, or the other amplitude of the profile.
        center: $c$ [L].
        shapes: the other constants of the profile, in its order.

    Raises:
        InputError: there is no such profile, or it has another number of constants.
    """

    law: str = eqx.field(static=True)
    height: Scalar
    center: Vector = eqx.field(
        metadata=dimension("L"), converter=point("ProfileBarrier.center")
    )
    shapes: tuple[Scalar, ...] = ()

    def __check_init__(self) -> None:
        if self.law not in PROFILES:
            raise InputError(
                f"ProfileBarrier.law: {self.law!r} is unknown; choose one of: "
                f"{', '.join(PROFILES)}"
            )
        expected = [shape.name for shape in PROFILES[self.law].shapes]
        if len(self.shapes) != len(expected):
            raise InputError(
                f"ProfileBarrier.shapes: {self.law} expects {len(expected)} "
                f"({', '.join(expected)}), got {len(self.shapes)}"
            )

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        offset = x - self.center
        profile = PROFILES[self.law]
        return self.height * profile.of_square(self.shapes, offset @ offset, NUMERIC)


class SoftWall(AbstractPotentialForce):
    r"""Repulsion $-\nabla U$ from a straight wall in the plane, a rounded step.

    $U(x) = U_0 / (1 + e^{-z})$ with $z = (n \cdot x - b) / w$ and
    $n = (\cos\phi, \sin\phi)$: low before the wall, $U_0$ behind it.

    Attributes:
        height: $U_0$ [L² T⁻²]; negative makes a drop.
        angle: $\phi$ of the normal that points into the wall [rad].
        offset: $b$ of the wall along the normal [L].
        width: $w$ [L], positive.

    Raises:
        InputError: `width` is a number <= 0.
    """

    height: Scalar = eqx.field(metadata=dimension("L2 T-2"))
    angle: Scalar = eqx.field(metadata=dimension("rad"))
    offset: Scalar = eqx.field(metadata=dimension("L"))
    width: Scalar = eqx.field(metadata=dimension("L"))

    def __check_init__(self) -> None:
        check_positive(self, "width")

    def potential(self, t: Scalar, x: Float[Array, "2"]) -> Float[Array, ""]:
        along = jnp.cos(self.angle) * x[0] + jnp.sin(self.angle) * x[1]
        return self.height * Step().value((self.width,), along - self.offset, NUMERIC)


class PlaneWaves(AbstractForce):
    r"""Force $-\nabla U$ of plane waves, $U(x) = \sum_j a_j \cos(k_j \cdot x + p_j)$.

    Two waves make an egg crate; many of random direction make a random field, whose
    covariance is the Fourier transform of the density of their wave vectors.

    Attributes:
        amplitudes: $a_j$ [L² T⁻²].
        wave_vectors: $k_j$ [rad L⁻¹].
        phases: $p_j$ [rad].

    Raises:
        InputError: their numbers differ.

    References:
        Rahimi and Recht, NeurIPS 2007, random Fourier features.
    """

    amplitudes: Float[Array, " wave"] = eqx.field(
        metadata=dimension("L2 T-2"), converter=jnp.asarray
    )
    wave_vectors: Float[Array, "wave dim"] = eqx.field(
        metadata=dimension("rad L-1"), converter=jnp.asarray
    )
    phases: Float[Array, " wave"] = eqx.field(
        metadata=dimension("rad"), converter=jnp.asarray
    )

    def __check_init__(self) -> None:
        shapes = [jnp.shape(part) for part in (self.amplitudes, self.phases)]
        if shapes != [jnp.shape(self.wave_vectors)[:1]] * 2:
            raise InputError(
                "PlaneWaves: expected an amplitude and a phase for each wave vector, "
                f"got {shapes[0]}, {shapes[1]} and {jnp.shape(self.wave_vectors)}"
            )

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        """Potential energy per mass $U(x)$ [L² T⁻²]."""
        return self.amplitudes @ jnp.cos(self.wave_vectors @ x + self.phases)

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        swing = self.amplitudes * jnp.sin(self.wave_vectors @ x + self.phases)
        return swing @ self.wave_vectors


class LinearForce(AbstractForce):
    r"""Force $F(x) = M (x - c)$: a saddle, a shear, a rigid rotation, or their sum.

    Attributes:
        matrix: $M$ [T⁻²]; symmetric where there is a potential.
        center: $c$ [L], where there is no force.

    Raises:
        InputError: `center` is not a point, or `matrix` is not square of its size.
    """

    matrix: Float[Array, "dim dim"] = eqx.field(
        metadata=dimension("T-2"), converter=jnp.asarray
    )
    center: Vector = eqx.field(
        metadata=dimension("L"), converter=point("LinearForce.center")
    )

    def __check_init__(self) -> None:
        size = jnp.shape(self.center)[0]
        if jnp.shape(self.matrix) != (size, size):
            raise InputError(
                f"LinearForce.matrix: expected shape {(size, size)}, got "
                f"{jnp.shape(self.matrix)}"
            )

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.matrix @ (x - self.center)
