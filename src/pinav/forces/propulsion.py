"""Forces by which a swimmer is driven: magnetic torque, rolling."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.actuation import AbstractField, AbstractProgramme, AbstractResponse
from pinav.arguments import Scalar, as_point
from pinav.errors import InputError
from pinav.forces.force import AbstractForce


class MagneticPropulsion(AbstractForce):
    r"""Thrust $\alpha\,|m \times B(t)|\,\hat a$ along the fixed body axis.

    With the paper's $m = \hat z$ and a field rotating in the plane the torque has
    the constant size $|m| B_0$: the thrust is constant and cannot steer.

    Attributes:
        field: the magnetic field $B(t)$.
        moment: dipole moment $m$ [J B⁻¹ per mass].
        gain: $\alpha$ [L⁻¹], thrust per torque.
        axis: unit vector $\hat a$ of the body.

    Raises:
        InputError: `moment` has not three components.

    References:
        PI-NAV paper, section 2.2.
    """

    field: AbstractField
    moment: Float[Array, "3"] = eqx.field(
        converter=lambda value: as_point("MagneticPropulsion.moment", value, 3)
    )
    gain: Scalar
    axis: Float[Array, " dim"] = eqx.field(
        converter=lambda value: as_point("MagneticPropulsion.axis", value)
    )

    def torque(self, t: Scalar) -> Float[Array, "3"]:
        r"""Magnetic torque $m \times B(t)$ per mass [L² T⁻²]."""
        return jnp.cross(self.moment, self.field(t))

    def __call__(self, t, x, v):
        return self.gain * jnp.linalg.norm(self.torque(t)) * self.axis.astype(x.dtype)


class RollingPropulsion(AbstractForce):
    r"""Velocity $G\, s(f(t - d))\, n(\theta(t - d))$ by frequency and heading.

    Attributes:
        gain: $G$ [L per cycle], a matrix: coils are unequal, and a heading may be off.
        response: $s(f)$, the effective frequency [Hz].
        programme: what was commanded: $f$ [Hz] and $\theta$ [rad].
        delay: $d$ from command to motion [s].

    References:
        Sokolich et al., arXiv:2406.02722, eq. (1), with scalar gain and no delay.
    """

    gain: Float[Array, "_ _"]
    response: AbstractResponse
    programme: AbstractProgramme
    delay: Scalar = 0.0

    def __check_init__(self):
        if jnp.shape(self.gain) != (2, 2):
            raise InputError(
                "RollingPropulsion.gain: expected a matrix of 2 rows and 2 columns, "
                f"got shape {jnp.shape(self.gain)}"
            )

    def __call__(self, t, x, v):
        return self.gain.astype(x.dtype) @ self.command(t).astype(x.dtype)

    def command(self, t: Scalar) -> Float[Array, "2"]:
        r"""$s(f)\, n(\theta)$ at the delayed time [Hz]."""
        frequency, heading = self.programme(jnp.asarray(t) - self.delay)
        direction = jnp.stack([jnp.cos(heading), jnp.sin(heading)])
        return self.response(frequency) * direction


def heading_offset(gain: Float[Array, "2 2"]) -> Float[Array, ""]:
    """Angle by which a gain matrix turns the commanded heading [rad]."""
    return jnp.arctan2(gain[1, 0] - gain[0, 1], gain[0, 0] + gain[1, 1])


def mean_gain(gain: Float[Array, "2 2"]) -> Float[Array, ""]:
    """Speed per effective frequency, without the turn: a scalar gain is itself."""
    return jnp.hypot(gain[1, 0] - gain[0, 1], gain[0, 0] + gain[1, 1]) / 2
