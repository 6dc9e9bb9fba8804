r"""Forces that drive a swimmer: magnetic torque, rolling, static magnetic fields.

The field may come from any function of places, such as `getB` of a magpylib source, or
from a measured map.
"""

import math
from collections.abc import Callable, Mapping, Sequence

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


def _as_values(values: ArrayLike) -> Float[Array, "..."]:
    array = values if isinstance(values, jax.Array) else jnp.asarray(values, float)
    if array.ndim not in (3, 4) or array.shape[-1] != 3 or min(array.shape[:-1]) < 4:
        raise InputError(
            "MagneticFieldTable.values: expected B with three components at 4 or more "
            f"points along each of two or three axes, got shape {array.shape}"
        )
    return array


class MagneticFieldTable(eqx.Module):
    r"""A magnetic field on an equally spaced grid, interpolated by cubic convolution.

    The field and its gradient are continuous. The error of the gradient falls as the
    square of the spacing. A table of two axes is the plane in which a swimmer moves;
    its field has three components all the same. Beyond the last cell but one the field
    continues as a constant, so that no force acts there.

    Attributes:
        lower: first point of the grid [L].
        spacing: between neighbours along each axis [L].
        values: B at the points [T]; the components come last.

    Raises:
        InputError: the values are no such table, or the vectors do not fit to it.

    References:
        Keys, IEEE Trans. Acoust. Speech Signal Process. 29, 1153 (1981), with a = -1/2.
    """

    lower: Vector = eqx.field(converter=point("MagneticFieldTable.lower"))
    spacing: Vector = eqx.field(converter=point("MagneticFieldTable.spacing"))
    values: Float[Array, "..."] = eqx.field(converter=_as_values)

    def __check_init__(self) -> None:
        axes = self.values.ndim - 1
        if self.lower.shape != (axes,) or self.spacing.shape != (axes,):
            raise InputError(
                f"MagneticFieldTable: the values have {axes} axes, but lower and "
                f"spacing have {self.lower.size} and {self.spacing.size} components"
            )

    @classmethod
    def sample(
        cls,
        field: Callable[[Float[np.ndarray, "point 3"]], ArrayLike],
        lower: ArrayLike | Sequence[float],
        upper: ArrayLike | Sequence[float],
        counts: Sequence[int],
        *,
        metre: float = 1.0,
        height: float = 0.0,
    ) -> "MagneticFieldTable":
        """The table of a field that is a function of places.

        For a source or a collection of magpylib, `field` is its `getB`:
        `MagneticFieldTable.sample(magnet.getB, lower, upper, counts, metre=1e6)` where
        lengths are in micrometres.

        Args:
            field: B [T] at places in metres, one a row.
            lower: first corner of the region [L], two or three coordinates.
            upper: the opposite corner [L].
            counts: points along each axis, 4 or more.
            metre: one metre in units of length.
            height: z of a planar table [L].

        Raises:
            InputError: the region is empty, a count is below 4, or the field is not
                finite there, as inside a source.
        """
        low, high, number = np.asarray(lower), np.asarray(upper), np.asarray(counts)
        if low.shape != high.shape or not (high > low).all() or number.min() < 4:
            raise InputError(
                "MagneticFieldTable.sample: expected lower < upper and 4 or more "
                f"points along each axis, got {lower}, {upper} and {counts}"
            )
        along = [np.linspace(*ends) for ends in zip(low, high, number, strict=True)]
        grid = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1)
        places = np.full((*grid.shape[:-1], 3), float(height))
        places[..., : grid.shape[-1]] = grid
        values = np.asarray(field(places.reshape(-1, 3) / metre), np.float64)
        if values.shape != (places.size // 3, 3) or not np.isfinite(values).all():
            raise InputError(
                "MagneticFieldTable.sample: expected three finite components of B at "
                f"each of {places.size // 3} places, got shape {values.shape} or "
                "values that are not finite; keep the region out of the sources"
            )
        spacing = (high - low) / (number - 1)
        return cls(low, spacing, values.reshape(places.shape))

    def __call__(self, x: Vector) -> Float[Array, "3"]:
        """Magnetic field [T] at a position [L]."""
        values = self.values.astype(x.dtype)
        most = jnp.asarray(values.shape[:-1], x.dtype)
        cells = (x - self.lower.astype(x.dtype)) / self.spacing.astype(x.dtype)
        place = jnp.clip(cells, 1.0, most - 2.0)
        cell = jnp.minimum(jnp.floor(place), most - 3.0)
        corner = cell.astype(int) - 1
        shape = (*(4 for _ in corner), 3)
        start = [*corner, jnp.zeros_like(corner[0])]
        block = jax.lax.dynamic_slice(values, start, shape)
        for weights in cubic_weights(place - cell):
            block = jnp.tensordot(weights, block, 1)
        return block

    def strength(self, x: Vector) -> Scalar:
        """Magnitude of the field [T] at a position [L]."""
        square = jnp.sum(self(x) ** 2)
        # The root has no derivative at 0; without a field there is no pull either.
        return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)


def cubic_weights(s: Float[Array, " axis"]) -> Float[Array, "axis 4"]:
    """Weights of four neighbours for a place between the inner two, along each axis."""
    return 0.5 * jnp.stack(
        [
            s * (-1 + s * (2 - s)),
            2 + s * s * (-5 + 3 * s),
            s * (1 + s * (4 - 3 * s)),
            s * s * (s - 1),
        ],
        axis=-1,
    )


class DipolePull(AbstractForce):
    r"""Pull $m\,\nabla |B|$ on a permanent dipole that aligns with the field.

    Attributes:
        moment: $m$, so that $m\,\nabla |B|$ is a force per mass [L² T⁻² tesla⁻¹].
    """

    table: MagneticFieldTable
    moment: Scalar = eqx.field(metadata=dimension("L2 T-2 tesla-1"))

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.moment * jax.grad(self.table.strength)(x)


class InductionPull(AbstractForce):
    r"""Pull $s\,\nabla |B|^2 / 2$ on a body that the field magnetises below saturation.

    For a sphere of volume $V$ and susceptibility $\chi \ll 1$ in a fluid,
    $s = V \chi / \mu_0$ per mass.

    Attributes:
        susceptibility: $s$ [L² T⁻² tesla⁻²].

    References:
        Jackson, Classical Electrodynamics, 3rd ed., section 5.7.
    """

    table: MagneticFieldTable
    susceptibility: Scalar = eqx.field(metadata=dimension("L2 T-2 tesla-2"))

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        def energy(x: Vector) -> Scalar:
            return 0.5 * jnp.sum(self.table(x) ** 2)

        return self.susceptibility * jax.grad(energy)(x)


Gain = Float[Array, "_ _"] | Float[Array, "_"] | Float[Array, ""]
"""A matrix, which a file states; one number for each axis; one number."""


def _as_gain(value: ArrayLike | Sequence) -> Gain:
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
        force: force on a unit mass [L T⁻²].

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
    drive it, see `pinav.dynamics.swimmers`.

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
                "programme out and give the commands to pinav.dynamics.swimmers"
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
        if self.programme is None:
            raise InputError(
                "RollingPropulsion: expected commands; bind those of a trajectory by "
                "pinav.dynamics.drive_by_arrays(model, times, commands), or give a "
                "programme"
            )
        command = jnp.stack(self.programme(jnp.asarray(t) - self.delay))
        return self.actuator(command).astype(x.dtype)

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
