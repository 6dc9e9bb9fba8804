"""A navigation task: its objective, and the places where a swimmer must not be."""

import abc
import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from pinav.arguments import Scalar, State, Vector, check_positive, point, real_array
from pinav.dynamics import AbstractSwimmer
from pinav.errors import InputError
from pinav.evaluation import FieldMap
from pinav.forces import AbstractSurface
from pinav.navigation.task.steering import CommandLimits, SteeredSwimmer


class AbstractPath(eqx.Module):
    """A curve that is to be followed at a speed, as a point that moves along it."""

    @abc.abstractmethod
    def __call__(self, t: Scalar) -> Vector:
        """Position at which the swimmer should be at time `t` [L]."""


class LinePath(AbstractPath):
    """Along a straight line, from end to end at constant speed; then at rest."""

    start: Vector = eqx.field(converter=point("LinePath.start"))
    end: Vector = eqx.field(converter=point("LinePath.end"))
    duration: Scalar

    def __check_init__(self) -> None:
        check_positive(self, "duration")

    def __call__(self, t: Scalar) -> Vector:
        progress = jnp.clip(jnp.asarray(t) / self.duration, 0.0, 1.0)
        return self.start + progress * (self.end - self.start)


class CirclePath(AbstractPath):
    r"""$c + r (\cos\phi, \sin\phi)$, $\phi = \phi_0 + 2\pi t / T$.

    Attributes:
        center: $c$ [L].
        radius: $r$ [L], positive.
        period: $T$ [T], positive: counter-clockwise.
        phase: $\phi_0$ [rad].
    """

    center: Vector = eqx.field(converter=point("CirclePath.center", 2))
    radius: Scalar
    period: Scalar
    phase: Scalar = 0.0

    def __check_init__(self) -> None:
        check_positive(self, "radius", "period")

    def __call__(self, t: Scalar) -> Vector:
        angle = self.phase + 2 * math.pi * jnp.asarray(t) / self.period
        return self.center + self.radius * jnp.stack([jnp.cos(angle), jnp.sin(angle)])


class FigureEightPath(AbstractPath):
    r"""Gerono's lemniscate $c + r (\sin\phi, \sin\phi\cos\phi)$, $\phi = 2\pi t / T$.

    Attributes:
        center: $c$, where it crosses itself [L].
        radius: $r$, half its length [L], positive.
        period: $T$ [T], positive.
    """

    center: Vector = eqx.field(converter=point("FigureEightPath.center", 2))
    radius: Scalar
    period: Scalar

    def __check_init__(self) -> None:
        check_positive(self, "radius", "period")

    def __call__(self, t: Scalar) -> Vector:
        angle = 2 * math.pi * jnp.asarray(t) / self.period
        across = jnp.sin(angle) * jnp.cos(angle)
        return self.center + self.radius * jnp.stack([jnp.sin(angle), across])


class AbstractObjective(eqx.Module):
    """An objective, and the end of it."""

    @abc.abstractmethod
    def target(self, t: Scalar) -> Vector:
        """Position at which the swimmer should be, or to go to, at time `t` [L]."""

    @abc.abstractmethod
    def distance(self, x: Vector) -> Float[Array, ""]:
        """From position `x` to where the task ends [L]: not positive there."""

    def is_reached(self, x: Vector) -> Bool[Array, ""]:
        """True where the task ends at position `x` [L]."""
        return self.distance(x) <= 0


class ReachGoal(AbstractObjective):
    """Come to a place, as soon as possible.

    Attributes:
        goal: its middle [L].
        tolerance: how near is there [L], positive.

    Raises:
        InputError: `goal` is not a point, or `tolerance` is not positive.
    """

    goal: Vector = eqx.field(converter=point("ReachGoal.goal"))
    tolerance: Scalar

    def __check_init__(self) -> None:
        check_positive(self, "tolerance")

    def target(self, t: Scalar) -> Vector:
        return self.goal

    def distance(self, x: Vector) -> Float[Array, ""]:
        return jnp.linalg.norm(x - self.goal) - self.tolerance


class FollowPath(AbstractObjective):
    """Stay on a point that moves along a path, until time is up."""

    path: AbstractPath

    def target(self, t: Scalar) -> Vector:
        return self.path(t)

    def distance(self, x: Vector) -> Float[Array, ""]:
        return jnp.full((), math.inf, x.dtype)


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


class Timing(eqx.Module):
    """Times at which commands come into force.

    Attributes:
        step: how long a command holds [T].
        delay: from a command until it is in force [T].
    """

    step: float = eqx.field(static=True)
    delay: float = eqx.field(static=True)

    @property
    def waiting(self) -> int:
        """Number of pending commands, with the one in force; one without a delay."""
        # Less a little, so that rounding does not add a step to a delay of whole ones.
        return max(math.ceil(self.delay / self.step - 1e-9), 1)

    @property
    def remainder(self) -> float:
        """Time for which the oldest pending command stays in force [T]."""
        return max(self.delay - (self.waiting - 1) * self.step, 0.0)

    @property
    def rest(self) -> float:
        """Rest of a control step when the oldest one has passed [T]."""
        rest = self.step - self.remainder
        return rest if rest > 1e-9 * self.step else 0.0


class Task(eqx.Module):
    """A true swimmer in a true environment, and what it is asked to do.

    The controller knows all of this but `truth`, of which it has a model.

    Attributes:
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

    def clearance(self, x: Vector) -> Float[Array, ""]:
        """Distance from the nearest forbidden place [L]: negative inside of one."""
        return clearance(x, self.keep_out, self.arena)

    @property
    def timing(self) -> Timing:
        """Times at which commands come into force."""
        return Timing(self.step, self.delay)

    @property
    def inertial(self) -> bool:
        """True where the state holds a velocity."""
        return self.start.shape[0] > self.dim


def steered_swimmer(task: Task, dynamics: AbstractSwimmer) -> SteeredSwimmer:
    """Fitted dynamics under the commands of a task."""
    return SteeredSwimmer(dynamics, task.truth.actuator)


@dataclasses.dataclass(frozen=True, eq=False)
class Course:
    """The places of a task of reaching a goal.

    Attributes:
        arena: lower and upper corner [L].
        discs: centre and radius of each disc, or ball, that must not be entered [L].
    """

    arena: Float[np.ndarray, "2 dim"]
    start: Float[np.ndarray, " dim"]
    goal: Float[np.ndarray, " dim"]
    tolerance: float
    discs: Float[np.ndarray, "disc number"]

    @classmethod
    def of(cls, task: Task) -> "Course":
        """The places of a task whose objective is a place to reach."""
        goal, dim = task.objective, task.dim
        assert isinstance(goal, ReachGoal)
        discs = [[*z.center, z.radius] for z in task.keep_out if isinstance(z, Disc)]
        return cls(
            arena=np.array([task.arena.lower, task.arena.upper], float),
            start=np.asarray(task.start[:dim], float),
            goal=np.asarray(goal.goal, float),
            tolerance=float(goal.tolerance),
            discs=np.array(discs, float).reshape(-1, dim + 1),
        )

    def grid(self, points: int) -> FieldMap:
        """A map of no force, with so many points along each side of the arena."""
        lower, upper = self.arena
        x, y = np.linspace(lower, upper, points).T
        shape = len(y), len(x)
        return FieldMap(x, y, np.zeros((*shape, 2)), np.zeros(shape))
