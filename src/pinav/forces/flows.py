"""Background flows that carry a swimmer."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jax.core import Tracer
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
from pinav.forces.surfaces import Bifurcation, Tube


class AbstractFlow(eqx.Module):
    """Velocity of the fluid where the swimmer is. No batch axis."""

    def __check_init__(self) -> None:
        refuse_text(self)

    @abc.abstractmethod
    def __call__(self, t: Scalar, x: Vector) -> Vector:
        """Velocity [L T⁻¹] at time `t` [T] and position `x` [L]."""


class ZeroFlow(AbstractFlow):
    """A fluid at rest."""

    def __call__(self, t: Scalar, x: Vector) -> Vector:
        return jnp.zeros_like(x)


class ShearFlow(AbstractFlow):
    r"""Simple shear $u = (\dot\gamma (y - y_0), 0)$ in the plane.

    Attributes:
        rate: $\dot\gamma$ [T⁻¹].
        origin: $y_0$, where the fluid is at rest [L].
    """

    rate: Scalar = eqx.field(metadata=dimension("T-1"))
    origin: Scalar = eqx.field(metadata=dimension("L"), default=0.0)

    def __call__(self, t: Scalar, x: Vector) -> Vector:
        return jnp.stack([self.rate * (x[1] - self.origin), jnp.zeros_like(x[0])])


class PoiseuilleFlow(AbstractFlow):
    r"""Flow $u = (u_m (1 - (y - y_0)^2 / R^2), 0)$ between two walls in the plane.

    Beyond the walls, where it would run backwards, the fluid is at rest; the walls
    themselves hold nothing back.

    Attributes:
        peak: $u_m$ in the middle [L T⁻¹].
        middle: $y_0$ [L].
        half_width: $R$, from the middle to a wall [L], positive.

    Raises:
        InputError: `half_width` is a number <= 0.
    """

    peak: Scalar = eqx.field(metadata=dimension("L T-1"))
    middle: Scalar = eqx.field(metadata=dimension("L"))
    half_width: Scalar = eqx.field(metadata=dimension("L"))

    def __check_init__(self) -> None:
        check_positive(self, "half_width")

    def __call__(self, t: Scalar, x: Vector) -> Vector:
        profile = 1 - ((x[1] - self.middle) / self.half_width) ** 2
        return jnp.stack([self.peak * jnp.maximum(profile, 0), jnp.zeros_like(x[0])])


class VortexFlow(AbstractFlow):
    r"""Gaussian vortex $u = \Omega \exp(-|x - c|^2 / 2w^2)\, \hat z \times (x - c)$.

    Attributes:
        rate: $\Omega$ of the rotation in the middle [rad T⁻¹]; counter-clockwise.
        center: $c$ [L].
        width: $w$ [L], positive.

    Raises:
        InputError: `center` is not a point in the plane, or `width` a number <= 0.
    """

    rate: Scalar = eqx.field(metadata=dimension("rad T-1"))
    center: Float[Array, "2"] = eqx.field(
        metadata=dimension("L"), converter=point("VortexFlow.center", 2)
    )
    width: Scalar = eqx.field(metadata=dimension("L"))

    def __check_init__(self) -> None:
        check_positive(self, "width")

    def __call__(self, t: Scalar, x: Vector) -> Vector:
        offset = x - self.center
        fading = jnp.exp(-0.5 * (offset @ offset) / self.width**2)
        return self.rate * fading * jnp.stack([-offset[1], offset[0]])


class SampledFlow(AbstractFlow):
    """A uniform velocity, linear between given times and constant beyond.

    Attributes:
        times: increasing times [T].
        velocities: velocities at those times [L T⁻¹].
    """

    times: Float[Array, " time"] = eqx.field(metadata=dimension("T"))
    velocities: Float[Array, "time dim"] = eqx.field(metadata=dimension("L T-1"))

    def __call__(self, t: Scalar, x: Vector) -> Vector:
        components = [
            jnp.interp(jnp.asarray(t, self.times.dtype), self.times, column)
            for column in self.velocities.T
        ]
        return jnp.stack(components).astype(x.dtype)


class SumFlow(AbstractFlow):
    """Sum of flows, each a term of its own."""

    terms: tuple[AbstractFlow, ...]

    def __call__(self, t: Scalar, x: Vector) -> Vector:
        return sum((flow(t, x) for flow in self.terms), jnp.zeros_like(x))


class UniformFlow(AbstractFlow):
    """A drift: the same velocity everywhere, at all times.

    Attributes:
        velocity: velocity of the fluid [L T⁻¹].
    """

    velocity: Vector = eqx.field(
        metadata=dimension("L T-1"), converter=point("UniformFlow.velocity")
    )

    def __call__(self, t: Scalar, x: Vector) -> Vector:
        return self.velocity.astype(x.dtype)


class TubeFlow(AbstractFlow):
    r"""Pulsatile flow in a straight tube, parabolic across it at all times.

    $$u(t, x) = u_m\,(1 + p \sin 2\pi f t)\,(1 - r^2/R^2)\, e$$

    at the distance r from the axis, whose direction is e; the fluid is at rest beyond
    the wall. It follows the pressure at once, which holds where the Womersley number
    $R \sqrt{2\pi f / \nu}$ is below one: below a radius of 0.4 mm at one beat a second.

    Attributes:
        peak: $u_m$, mean over time on the axis [L T⁻¹]; negative runs backwards.
        tube: where the wall is.
        pulse: p, part of the mean by which the flow swings [1].
        frequency: f [cycles T⁻¹].

    References:
        Womersley, J. Physiol. 127, 553 (1955).
    """

    peak: Scalar = eqx.field(metadata=dimension("L T-1"))
    tube: Tube
    pulse: Scalar = eqx.field(metadata=dimension("1"), default=0.0)
    frequency: Scalar = eqx.field(metadata=dimension("cycles T-1"), default=1.0)

    def __call__(self, t: Scalar, x: Vector) -> Vector:
        across = self.tube.from_axis(x)
        profile = jnp.maximum(1 - (across @ across) / self.tube.radius**2, 0.0)
        swing = _swing(self.pulse, self.frequency, t)
        speed = self.peak * profile * swing.astype(x.dtype)
        return speed * self.tube.axis.astype(x.dtype)


class BifurcationFlow(AbstractFlow):
    r"""Pulsatile flow through tubes that meet: in by the first, out by the others.

    $$u = (1 + p \sin 2\pi f t) \frac{\sum_i q_i^3\, u_i\, e_i}{\sum_i q_i^2},
    \qquad q_i = \max(1 - r_i^2 / R_i^2, 0),$$

    where $r_i$ is the distance from the axis of tube i and $e_i$ its direction. Where
    the tubes do not overlap this is the parabolic flow of each of them, and at the wall
    the fluid is at rest. $u_1 = -u_m$ and $u_i = u_m\, s_i R_1^2 / R_i^2$, so that the
    part $s_i$ of the volume leaves through tube i. Where they overlap, within about a
    radius of the point where they meet, the flow is a weighted mean of theirs and not
    free of sources: between two tubes that continue each other it is up to 11 % too
    slow. It follows the pressure at once, as
    that of `TubeFlow`.

    Attributes:
        peak: $u_m$, mean over time on the axis of the first tube, towards the others
            [L T⁻¹]; negative runs backwards.
        wall: where the walls are; its first tube is the trunk.
        shares: $s_i$ of the other tubes, which sum to 1.
        pulse: p, part of the mean by which the flow swings [1].
        frequency: f [cycles T⁻¹].

    Raises:
        InputError: `shares` are not as many as tubes after the first, or do not sum
            to 1.
    """

    peak: Scalar = eqx.field(metadata=dimension("L T-1"))
    wall: Bifurcation
    shares: Float[Array, " branch"] = eqx.field(converter=jnp.asarray)
    pulse: Scalar = eqx.field(metadata=dimension("1"), default=0.0)
    frequency: Scalar = eqx.field(metadata=dimension("cycles T-1"), default=1.0)

    def __check_init__(self) -> None:
        branches = len(self.wall.radii) - 1
        if self.shares.shape != (branches,):
            raise InputError(
                f"BifurcationFlow.shares: expected {branches} of them, one for each "
                f"tube after the first, got {self.shares.shape}"
            )
        if isinstance(self.shares, Tracer):
            return
        if abs(float(jnp.sum(self.shares)) - 1) > 1e-6:
            raise InputError(
                "BifurcationFlow.shares: expected parts that sum to 1, got "
                f"{self.shares}"
            )

    def __call__(self, t: Scalar, x: Vector) -> Vector:
        radii = self.wall.radii.astype(x.dtype)
        across = self.wall.from_axes(x)
        profiles = jnp.maximum(1 - jnp.sum(across**2, axis=1) / radii**2, 0.0)
        shares = jnp.concatenate([-jnp.ones(1, x.dtype), self.shares.astype(x.dtype)])
        speeds = self.peak * shares * radii[0] ** 2 / radii**2
        swing = _swing(self.pulse, self.frequency, t).astype(x.dtype)
        together = jnp.maximum(jnp.sum(profiles**2), TINY)
        directed = (profiles**3 * speeds) @ self.wall.axes.astype(x.dtype)
        return swing * directed / together


TINY = 1e-30
"""Sum of the squared profiles of tubes below which a place counts as outside of all."""


def _swing(pulse: Scalar, frequency: Scalar, t: Scalar) -> Float[Array, ""]:
    return 1 + pulse * jnp.sin(2 * jnp.pi * frequency * jnp.asarray(t))
