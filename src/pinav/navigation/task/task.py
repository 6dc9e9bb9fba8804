"""A navigation task, and the places where a swimmer must not be."""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from pinav.arguments import Scalar, State, Vector, check_positive, point, real_array
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.forces import AbstractSurface
from pinav.navigation.task.objectives import AbstractObjective
from pinav.navigation.task.steering import CommandLimits, SteeredSwimmer


class AbstractZone(eqx.Module):
    """A region of the plane or of space."""

    @abc.abstractmethod
    def distance(self, x: Vector) -> Float[Array, ""]:
        """Signed distance from its edge [L]: negative inside."""


class Disc(AbstractZone):
    """A disc in the plane, a ball in space.

    Attributes:
        radius: [L], positive.

    Raises:
        InputError: `center` is not a point, or `radius` a number <= 0.
    """

    center: Vector = eqx.field(converter=point("Disc.center"))
    radius: Scalar

    def __check_init__(self) -> None:
        check_positive(self, "radius")

    def distance(self, x: Vector) -> Float[Array, ""]:
        return _length(x - self.center) - self.radius


class Wall(AbstractZone):
    """A straight wall with round ends: in space, a rod.

    Attributes:
        start: where its middle line begins [L].
        end: where it ends [L].
        half_width: from the middle line to the surface [L], positive.

    Raises:
        InputError: an end is not a point, or `half_width` a number <= 0.
    """

    start: Vector = eqx.field(converter=point("Wall.start"))
    end: Vector = eqx.field(converter=point("Wall.end"))
    half_width: Scalar

    def __check_init__(self) -> None:
        check_positive(self, "half_width")

    def distance(self, x: Vector) -> Float[Array, ""]:
        along = self.end - self.start
        fraction = jnp.clip((x - self.start) @ along / (along @ along), 0.0, 1.0)
        return _length(x - self.start - fraction * along) - self.half_width


class Rectangle(AbstractZone):
    """A rectangle, or box, along the axes: also the arena, which must not be left.

    Raises:
        InputError: a corner is not a point, or `lower` is not below
            `upper`.
    """

    lower: Vector = eqx.field(converter=point("Rectangle.lower"))
    upper: Vector = eqx.field(converter=point("Rectangle.upper"))

    def __check_init__(self) -> None:
        lower, upper = self.lower, self.upper
        if not isinstance(lower, Tracer) and not bool(jnp.all(lower < upper)):
            raise InputError(
                f"Rectangle: expected lower below upper, got {lower} and {upper}"
            )

    @property
    def dim(self) -> int:
        """Number of dimensions."""
        return self.lower.shape[0]

    def distance(self, x: Vector) -> Float[Array, ""]:
        beyond = jnp.maximum(self.lower - x, x - self.upper)
        outside = _length(jnp.maximum(beyond, 0.0))
        return outside + jnp.minimum(jnp.max(beyond), 0.0)


class Behind(AbstractZone):
    """The region behind a surface, or nearer to it than a distance.

    Attributes:
        surface: such as a wall of the system.
        nearest: distance that is kept from it, such as the swimmer's radius [L].
    """

    surface: AbstractSurface
    nearest: Scalar = 0.0

    def distance(self, x: Vector) -> Float[Array, ""]:
        return self.surface.distance(x) - self.nearest


def clearance(
    x: Vector, keep_out: tuple[AbstractZone, ...], arena: Rectangle
) -> Float[Array, ""]:
    """Distance from the nearest forbidden place [L]: negative inside of one."""
    distances = [zone.distance(x) for zone in keep_out]
    return jnp.min(jnp.stack([*distances, -arena.distance(x)]))


def _length(offset: Vector) -> Float[Array, ""]:
    """Length of a vector, with a gradient of zero where it vanishes."""
    square = offset @ offset
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


class Task(eqx.Module):
    """A true swimmer in a true environment, and what it is asked to do.

    The controller knows all of this but `truth`, of which it has a model.

    Attributes:
        start: its first state.
        limits: what may be commanded.
        arena: what must not be left.
        keep_out: what must not be entered.
        step: how long a command holds [T].
        time_limit: when the task is over [T].
        noise: strength of the white noise: of the acceleration [L T^-3/2] where the
            state has a velocity, else of the velocity [L T^-1/2]. Over the time dt it
            adds a normal number of standard deviation noise * sqrt(dt).
        sensor_noise: standard deviation of what the controller is told of each
            component of the state.
        delay: from command to thrust [T].
    """

    name: str = eqx.field(static=True)
    truth: SteeredSwimmer
    start: State = eqx.field(converter=real_array)
    objective: AbstractObjective
    limits: CommandLimits
    arena: Rectangle
    keep_out: tuple[AbstractZone, ...]
    step: float = eqx.field(static=True)
    time_limit: float = eqx.field(static=True)
    noise: float = 0.0
    sensor_noise: float = 0.0
    delay: float = eqx.field(static=True, default=0.0)

    @property
    def dim(self) -> int:
        """Dimensions of the space."""
        return self.arena.dim

    @property
    def extent(self) -> float:
        """Longer side of the arena [L]."""
        return float(
            np.max(np.asarray(self.arena.upper) - np.asarray(self.arena.lower))
        )

    @property
    def position_sd(self) -> float:
        """Standard deviation of an observed position as a belief takes it [L].

        A sensor without any error is taken to be sure to a ten-millionth of the arena.
        """
        return max(self.sensor_noise, 1e-7 * self.extent)

    @property
    def inertial(self) -> bool:
        """True where the state holds a velocity."""
        return self.start.shape[0] > self.dim


def steered_swimmer(
    task: Task, dynamics: Swimmer | OverdampedSwimmer
) -> SteeredSwimmer:
    """Fitted dynamics under the commands of a task."""
    return SteeredSwimmer(dynamics, task.truth.actuator)
