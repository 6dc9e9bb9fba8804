r"""Known landscapes: a barrier, a trap, waves, a linear force; and laws by name.

Forces that are a profile of a geometry are values of `LawForce`. The functions here
make them of the constants that files state, under the names that they have there.
"""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Planar, Scalar, Vector, check_positive, dimension, point
from pinav.errors import InputError
from pinav.forces.force import AbstractForce, AbstractPotentialForce
from pinav.forces.formulas import NUMERIC
from pinav.forces.geometries import Center, Ellipse, Line
from pinav.forces.law_force import LawForce, force_of
from pinav.forces.laws import ProfileLaw, Turned
from pinav.forces.profiles import (
    PROFILES,
    AbstractProfile,
    CompactHill,
    Gaussian,
    InversePower,
    Ring,
    Step,
)
from pinav.settings import POSITIVE


class GaussianBarrier(AbstractPotentialForce):
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

    def __check_init__(self) -> None:
        check_positive(self, "width")

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        offset = x - self.center
        square = offset @ offset
        return self.height * Gaussian().of_square((self.width,), square, NUMERIC)


class HarmonicTrap(AbstractPotentialForce):
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

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        offset = x - self.center
        return self.stiffness * (offset @ offset) / 2


Point = Vector | np.ndarray | list | tuple
"""A point of the space [L]."""

PlanarPoint = Planar | np.ndarray | list | tuple
"""A point of the plane [L]."""


def about_center(
    profile: AbstractProfile, height: Scalar, center: Point, *shapes: Scalar
) -> LawForce:
    """The force of a profile about a centre [L], in any dimension."""
    place = point("center")(center)
    return force_of(ProfileLaw(profile, Center(len(place))), height, place, *shapes)


def profile_barrier(
    law: str, height: Scalar, center: Point, shapes: tuple[Scalar, ...] = ()
) -> LawForce:
    r"""Repulsion $-\nabla U$ from any profile about a centre, $U(x) = U_0 L(|x - c|)$.

    Args:
        law: name of the profile, such as "Yukawa".
        height: $U_0$, or the other amplitude of the profile.
        center: $c$ [L].
        shapes: the other constants of the profile, in its order.

    Raises:
        InputError: there is no such profile, it has another number of constants, or
            one of them is a number <= 0.
    """
    if law not in PROFILES:
        raise InputError(
            f"profile_barrier law: {law!r} is unknown; choose one of: "
            f"{', '.join(PROFILES)}"
        )
    return about_center(PROFILES[law], height, center, *shapes)


def power_hill(
    height: Scalar, center: Point, core: Scalar, exponent: Scalar
) -> LawForce:
    r"""Repulsion $-\nabla U$ from $U(x) = U_0 (1 + |x - c|^2 / s^2)^{-p}$.

    With $p = 1/2$ a screened charge, with $p = 1$ a Lorentzian: tails that no Gaussian
    has.
    """
    return about_center(InversePower(), height, center, core, 2 * exponent)


def compact_hill(height: Scalar, center: Point, radius: Scalar) -> LawForce:
    r"""Repulsion $-\nabla U$ from $U(x) = U_0 (1 - |x - c|^2 / R^2)^3$ within $R$.

    Beyond $R$ there is no force; force and gradient are continuous there.
    """
    return about_center(CompactHill(), height, center, radius, 3.0)


def ring_barrier(
    height: Scalar, center: Point, radius: Scalar, width: Scalar
) -> LawForce:
    r"""Repulsion $-\nabla U$ from $U(x) = U_0 \exp(-(|x - c| - \rho)^2 / 2 w^2)$.

    At the very centre the force has no direction; it counts as zero there.
    """
    return about_center(Ring(), height, center, radius, width)


def soft_wall(height: Scalar, angle: Scalar, offset: Scalar, width: Scalar) -> LawForce:
    r"""Repulsion $-\nabla U$ from a straight wall in the plane, a rounded step.

    $U(x) = U_0 / (1 + e^{-z})$ with $z = (n \cdot x - b) / w$ and
    $n = (\cos\phi, \sin\phi)$: low before the wall, $U_0$ behind it.

    Args:
        angle: $\phi$ of the normal that points into the wall [rad].
        offset: $b$ of the wall along the normal [L].
    """
    return force_of(ProfileLaw(Step(), Line()), height, angle, offset, width)


def gaussian_ridge(
    height: Scalar, center: PlanarPoint, length: Scalar, width: Scalar, angle: Scalar
) -> LawForce:
    r"""Repulsion $-\nabla U$ from an elongated Gaussian in the plane: a fibre.

    $U(x) = U_0 \exp(-\tfrac12 (a^2 / l^2 + b^2 / w^2))$, with the coordinates $a$ along
    and $b$ across the ridge, which is turned by an angle from the x axis [rad]. With
    $l = w$ it is a `GaussianBarrier`.
    """
    for name, value in (("length", length), ("width", width)):
        POSITIVE.check(f"gaussian_ridge {name}", value)
    aspect, size = length / width, jnp.sqrt(length * width)
    place = point("center", 2)(center)
    law = ProfileLaw(Gaussian(), Ellipse())
    return force_of(law, height, place, aspect, angle, size)


def gaussian_swirl(strength: Scalar, center: PlanarPoint, width: Scalar) -> LawForce:
    r"""Rotational force $(\partial_y \psi, -\partial_x \psi)$ in the plane.

    With $\psi(x) = S \exp(-|x - c|^2 / 2w^2)$: it has no potential and no divergence,
    and pushes counter-clockwise where S is positive. Over the whole plane
    $\int |F|^2 = \pi S^2$, as it is $\pi U_0^2$ for a `GaussianBarrier`, whatever the
    widths; the two are orthogonal there.
    """
    law = Turned(ProfileLaw(Gaussian(), Center()))
    return force_of(law, strength, point("center", 2)(center), width)


NAMED: tuple[Callable[..., LawForce], ...] = (
    profile_barrier,
    power_hill,
    compact_hill,
    ring_barrier,
    soft_wall,
    gaussian_ridge,
    gaussian_swirl,
)
"""Laws that files state by a name and constants of their own."""


class PlaneWaves(AbstractPotentialForce):
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
        return self.amplitudes @ jnp.cos(self.wave_vectors @ x + self.phases)


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
