"""Objectives of a swimmer: to reach a place, or to follow a path."""

import abc
import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from pinav.arguments import Scalar, Vector, check_positive, point


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
