"""Forces by which a swimmer is driven: magnetic torque, rolling."""

import math
from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from pinav.actuation import (
    AbstractField,
    AbstractProgramme,
    AbstractResponse,
    HeldProgramme,
    LinearResponse,
    RollingActuator,
    follow,
)
from pinav.arguments import Scalar, Vector, dimension, point
from pinav.errors import InputError
from pinav.forces.force import AbstractCommandedForce, AbstractForce

Gain = Float[Array, "_ _"] | Float[Array, "_"] | Float[Array, ""]
"""A matrix, which a file states; one number for each axis; one number."""


def _as_gain(value: ArrayLike) -> Gain:
    if np.shape(value) not in ((), (2,), (2, 2)):
        raise InputError(
            "RollingPropulsion.gain: expected a matrix of 2 rows and 2 columns, or one "
            f"number, or one for each axis, got shape {np.shape(value)}"
        )
    return value if isinstance(value, jax.Array) else jnp.asarray(value, float)


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
        converter=point("MagneticPropulsion.moment", 3)
    )
    gain: Scalar = eqx.field(metadata=dimension("L-1"))
    axis: Vector = eqx.field(converter=point("MagneticPropulsion.axis"))

    def torque(self, t: Scalar) -> Float[Array, "3"]:
        r"""Magnetic torque $m \times B(t)$ per mass [L² T⁻²]."""
        return jnp.cross(self.moment, self.field(t))

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.gain * jnp.linalg.norm(self.torque(t)) * self.axis.astype(x.dtype)


class ConstantForce(AbstractForce):
    """The same force everywhere, at all times: a constant thrust, or gravity.

    Attributes:
        force: [L T⁻²].

    Raises:
        InputError: `force` is not a vector.
    """

    force: Vector = eqx.field(
        metadata=dimension("L T-2"), converter=point("ConstantForce.force")
    )

    @classmethod
    def of(cls, magnitude: float, degrees: float) -> "ConstantForce":
        """The force of this size in the plane, at an angle to the x axis [degrees]."""
        angle = math.radians(degrees)
        return cls([magnitude * math.cos(angle), magnitude * math.sin(angle)])

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.force.astype(x.dtype)


class RollingPropulsion(AbstractCommandedForce):
    r"""Velocity $G\, s(f(t - d))\, n(\theta(t - d))$ by frequency and heading.

    Without a programme it is a part of a system: the commands of each trajectory
    drive it, see `pinav.dynamics.commanded`.

    Attributes:
        gain: $G$ [L per cycle], a matrix: coils are unequal, and a heading may be off;
            one number, or one for each axis, where they are not.
        response: $s(f)$, the effective frequency [Hz].
        programme: what was commanded, $f$ [Hz] and $\theta$ [rad]; None where each
            trajectory says so.
        delay: $d$ from command to motion [s].
        lag: T of a first-order follower of the command, $T \dot c' = c - c'$ [s]; 0
            where it follows at once.

    Raises:
        InputError: `gain` is no matrix, or there is a lag beside a programme.

    References:
        Sokolich et al., arXiv:2406.02722, eq. (1), with scalar gain and no delay.
    """

    gain: Gain = eqx.field(metadata=dimension("L"), converter=_as_gain)
    response: AbstractResponse = LinearResponse()
    programme: AbstractProgramme | None = None
    delay: Scalar = eqx.field(metadata=dimension("s"), default=0.0)
    lag: Scalar = eqx.field(metadata=dimension("s"), default=0.0)

    def __check_init__(self) -> None:
        if self.programme is not None and not _is_zero(self.lag):
            raise InputError(
                "RollingPropulsion.lag: expected 0 beside a programme; leave the "
                "programme out and give the commands to pinav.dynamics.commanded"
            )

    @classmethod
    def of(
        cls,
        speed: float,
        heading_offset: float = 0.0,
        response: AbstractResponse | None = None,
        programme: AbstractProgramme | None = None,
        delay: float = 0.0,
        lag: float = 0.0,
    ) -> "RollingPropulsion":
        """The propulsion of a speed per frequency, turned by an offset [rad]."""
        cos, sin = math.cos(heading_offset), math.sin(heading_offset)
        gain = speed * jnp.array([[cos, -sin], [sin, cos]])
        response = LinearResponse() if response is None else response
        return cls(
            gain=gain, response=response, programme=programme, delay=delay, lag=lag
        )

    @property
    def matrix(self) -> Float[Array, "2 2"]:
        """The gain as a matrix [L per cycle]."""
        if self.gain.ndim == 2:
            return self.gain
        return jnp.diag(jnp.broadcast_to(self.gain, 2))

    @property
    def actuator(self) -> RollingActuator:
        return RollingActuator(self.matrix, self.response)

    @property
    def lateness(self) -> float:
        """The delay and the time constant of the lag together.

        A first-order follower is taken for a further delay by its time constant, which
        is right for commands that change slowly against it.
        """
        return float(self.delay) + float(self.lag)

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.matrix.astype(x.dtype) @ self.command(t).astype(x.dtype)

    def command(self, t: Scalar) -> Float[Array, "2"]:
        r"""$s(f)\, n(\theta)$ at the delayed time [Hz].

        Raises:
            InputError: there is no programme.
        """
        if self.programme is None:
            raise InputError(
                "RollingPropulsion: expected commands; bind those of a trajectory by "
                "pinav.dynamics.drive_by_commands(model, trajectory), or give a "
                "programme"
            )
        frequency, heading = self.programme(jnp.asarray(t) - self.delay)
        direction = jnp.stack([jnp.cos(heading), jnp.sin(heading)])
        return self.response(frequency) * direction

    def drive_by(
        self,
        times: Float[Array, " time"],
        commands: Mapping[str, Float[Array, " time"]],
    ) -> AbstractForce:
        missing = [name for name in ("frequency", "heading") if name not in commands]
        if missing:
            raise InputError(
                f"commands: {' and '.join(missing)} not recorded, so that the "
                "propulsion of the system cannot be driven; give a recording with "
                "both, or a system without a propulsion that takes commands"
            )
        programme = HeldProgramme(times, commands["frequency"], commands["heading"])
        wanted = programme.commands(self.response)
        reached = wanted if _is_zero(self.lag) else _follow(times, wanted, self.lag)
        turned = self.matrix.astype(wanted.dtype).T
        return ScheduledThrust(
            times, wanted @ turned, reached @ turned, self.delay, self.lag
        )


class ScheduledThrust(AbstractForce):
    """A thrust that changes at given times and is reached with delay and lag.

    Before its first time it has its first value. It jumps: adaptive solvers read
    `jumps` and end a step at each.

    Attributes:
        times: when each thrust was asked for [T].
        asked: thrust from then on [F].
        reached: what acts at that time, behind by the lag [F].
        delay: from command to motion [T].
        lag: of a first-order follower [T].
    """

    times: Float[Array, " time"] = eqx.field(metadata=dimension("T"))
    asked: Float[Array, "time dim"] = eqx.field(metadata=dimension("F"))
    reached: Float[Array, "time dim"] = eqx.field(metadata=dimension("F"))
    delay: Scalar = eqx.field(metadata=dimension("T"))
    lag: Scalar = eqx.field(metadata=dimension("T"))

    @property
    def jumps(self) -> Float[Array, " time"]:
        """Times at which the thrust, or its derivative, jumps [T]."""
        return self.times + self.delay

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        t = jnp.asarray(t, self.times.dtype) - self.delay
        last = self.times.shape[0] - 1
        index = jnp.searchsorted(self.times, t, side="right") - 1
        index = jnp.clip(index, 0, last)
        elapsed = jnp.maximum(t - self.times[index], 0.0)
        asked, reached = self.asked[index], self.reached[index]
        behind = jnp.exp(-elapsed / jnp.where(self.lag > 0, self.lag, 1.0))
        return (asked + (reached - asked) * behind).astype(x.dtype)


def _follow(
    times: Float[Array, " time"], commands: Float[Array, "time 2"], lag: Scalar
) -> Float[Array, "time 2"]:
    """State of a follower; the commands themselves where the lag is 0."""
    # The untaken branch of a division by zero would make gradients NaN.
    behind = follow(times, commands, jnp.where(lag > 0, lag, 1.0))
    return jnp.where(lag > 0, behind, commands)


def _is_zero(value: Scalar) -> bool:
    return isinstance(value, float | int) and value == 0


def heading_offset(gain: Float[Array, "2 2"]) -> Float[Array, ""]:
    """Angle by which a gain matrix turns the commanded heading [rad]."""
    return jnp.arctan2(gain[1, 0] - gain[0, 1], gain[0, 0] + gain[1, 1])


def mean_gain(gain: Float[Array, "2 2"]) -> Float[Array, ""]:
    """Speed per effective frequency, without the turn: a scalar gain is itself."""
    return jnp.hypot(gain[1, 0] - gain[0, 1], gain[0, 0] + gain[1, 1]) / 2
