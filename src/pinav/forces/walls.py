r"""A sphere near a wall: its mobility, its weight, and the wall's double layer.

Lengths are in um, viscosities in mPa s and forces in pN. A gap is $\epsilon = h / a$,
the distance between surface and wall in radii; a mobility is relative to that far from
the wall.
"""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector, check_positive, dimension, point
from pinav.errors import InputError
from pinav.forces.force import AbstractForce
from pinav.forces.surfaces import AbstractSurface
from pinav.forces.tensors import AbstractTensorField

GRAVITY = 9.81e-6
"""Weight of a mass density of 1 kg m⁻³ in a volume of 1 um³ [pN]."""

LEAST_GAP = 1e-3
"""Gap [radii] below which a mobility stays what it is there, so that it is positive."""


def stokes_drag(radius: float, viscosity: float) -> float:
    r"""Drag $6 \pi \mu a$ of a sphere [pN s µm⁻¹].

    Args:
        radius: $a$ [µm].
        viscosity: $\mu$ [mPa s = 1e-3 pN s µm⁻²]; that of water at 25 °C is 0.89.
    """
    return 6 * math.pi * viscosity * 1e-3 * radius


def normal_mobility(gap: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    r"""Mobility normal to a wall, within 0.8 % of Brenner's series, and quick.

    $$D_\perp / D_0 = (6\epsilon^2 + 2\epsilon) / (6\epsilon^2 + 9\epsilon + 2).$$

    References:
        Bevan and Prieve, J. Chem. Phys. 113, 1228 (2000).
    """
    gap = jnp.maximum(gap, LEAST_GAP)
    return (6 * gap**2 + 2 * gap) / (6 * gap**2 + 9 * gap + 2)


def parallel_mobility(gap: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    r"""Mobility along a wall of a sphere that does not turn.

    With $u = 1 / (1 + \epsilon)$ Faxen's series with two more terms,

    $$1 - \tfrac{9}{16} u + \tfrac18 u^3 - \tfrac{45}{256} u^4 - \tfrac1{16} u^5
    + 0.22206\, u^6 - 0.205216\, u^7,$$

    from a gap of `FAR` on, below `NEAR` that of lubrication, $D_0 / D_\parallel =
    -\frac8{15} \ln\epsilon + 0.95429 - \frac{64}{375} \epsilon\ln\epsilon + 0.42945\,
    \epsilon$, and a smooth passage in between. Within 2e-3 of the table of Goldman, Cox
    and Brenner from 0.003 to 9; a sphere that turns freely is up to 1 % quicker.

    References:
        Faxen, Ark. Mat. Astron. Fys. 17, 27 (1923); Goldman, Cox and Brenner, Chem.
        Eng. Sci. 22, 637 (1967); Perkins and Jones, Physica A 189, 447 (1992); Chaoui
        and Feuillebois, Q. J. Mech. Appl. Math. 56, 381 (2003).
    """
    gap = jnp.maximum(gap, LEAST_GAP)
    u = 1 / (1 + gap)
    far = 1 - 9 / 16 * u + u**3 / 8 - 45 / 256 * u**4 - u**5 / 16
    far = far + 0.22206 * u**6 - 0.205216 * u**7
    close = jnp.minimum(gap, FAR)  # beyond, its logarithm would change sign
    drag = 0.95429 + 0.42945 * close
    drag = drag - (8 / 15 + 64 / 375 * close) * jnp.log(close)
    place = jnp.clip((gap - NEAR) / (FAR - NEAR), 0.0, 1.0)
    part = place**3 * (10 - 15 * place + 6 * place**2)
    return part * far + (1 - part) / drag


NEAR, FAR = 0.11, 0.14
"""Gaps [radii] between which lubrication passes into the series."""


class WallMobility(AbstractTensorField):
    r"""Mobility of a sphere near a wall, in two dimensions or three.

    $M = (M_\perp\, n n^\top + M_\parallel (I - n n^\top)) / 6\pi\mu a$ with
    `normal_mobility` and `parallel_mobility` of the gap. It vanishes at contact
    normal to the wall, so that its divergence pushes away from the wall where there is
    heat: leave that out, and the wall seems to repel. A curved wall counts as the plane
    that touches it where it is nearest, which holds for spheres that are small against
    its radius; the far side of a tube is left out.

    Attributes:
        radius: $a$ [um], positive.
        viscosity: $\mu$ [mPa s], positive.

    Raises:
        InputError: `radius` or `viscosity` is a number <= 0.
    """

    radius: Scalar = eqx.field(metadata=dimension("um"))
    viscosity: Scalar = eqx.field(metadata=dimension("mPa s"))
    wall: AbstractSurface

    def __check_init__(self) -> None:
        check_positive(self, "radius", "viscosity")

    def gap(self, x: Vector) -> Float[Array, ""]:
        """Distance between surface and wall [radii] for a centre at `x`."""
        return self.wall.distance(x) / self.radius - 1

    def __call__(self, x: Vector, vector: Vector) -> Vector:
        return self._apply(x, vector, *self._principal(x))

    def factor(self, x: Vector, vector: Vector) -> Vector:
        return self._apply(x, vector, *map(jnp.sqrt, self._principal(x)))

    def _principal(self, x: Vector) -> tuple[Array, Array]:
        drag = 6e-3 * math.pi * self.viscosity * self.radius
        gap = self.gap(x)
        return normal_mobility(gap) / drag, parallel_mobility(gap) / drag

    def _apply(self, x: Vector, vector: Vector, across: Array, along: Array) -> Vector:
        normal = self.wall.normal_at(x)
        return along * vector + (across - along) * (normal @ vector) * normal


class Weight(AbstractForce):
    r"""Weight of a sphere less its buoyancy, $\frac43 \pi a^3\, \Delta\rho\, g$.

    Attributes:
        radius: $a$ [um], positive.
        excess_density: $\Delta\rho$ of the sphere over the fluid [kg m⁻³].
        down: direction of gravity; its length is without effect.

    Raises:
        InputError: `radius` is a number <= 0, or `down` is no vector or zero.
    """

    radius: Scalar = eqx.field(metadata=dimension("um"))
    excess_density: Scalar = eqx.field(metadata=dimension("kg m-3"))
    down: Vector = eqx.field(converter=point("Weight.down"))

    def __check_init__(self) -> None:
        check_positive(self, "radius")
        if not jnp.any(self.down != 0):
            raise InputError("Weight.down: expected a vector that is not zero")

    @property
    def size(self) -> Scalar:
        """The force [pN]."""
        return 4 / 3 * math.pi * self.radius**3 * self.excess_density * GRAVITY

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        down = self.down / jnp.linalg.norm(self.down)
        return self.size * down.astype(x.dtype)


class DoubleLayer(AbstractForce):
    r"""Screened repulsion of a sphere by a wall, $U = E\, e^{-h / \ell}$.

    A sphere that reaches into the wall is pushed as at contact.

    Attributes:
        energy: $E$ where the surfaces touch [pN um]; a few $k_B T$ or more.
        length: $\ell$, the Debye length [um], positive.
        radius: of the sphere [um], positive.

    Raises:
        InputError: `length` or `radius` is a number <= 0.

    References:
        Prieve, Adv. Colloid Interface Sci. 82, 93 (1999).
    """

    energy: Scalar = eqx.field(metadata=dimension("pN um"))
    length: Scalar = eqx.field(metadata=dimension("um"))
    radius: Scalar = eqx.field(metadata=dimension("um"))
    wall: AbstractSurface

    def __check_init__(self) -> None:
        check_positive(self, "length", "radius")

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        """Potential energy [pN um]."""
        gaps = self._gap(x)
        return self.energy * (jnp.exp(-jnp.maximum(gaps, 0)) - jnp.minimum(gaps, 0))

    def _gap(self, x: Vector) -> Float[Array, ""]:
        return (self.wall.distance(x) - self.radius) / self.length

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        push = self.energy / self.length * jnp.exp(-jnp.maximum(self._gap(x), 0))
        return push * self.wall.normal_at(x)
