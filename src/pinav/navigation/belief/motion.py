r"""A step of a swimmer in a force that is known by a mean and its slope."""

import abc
import dataclasses
import functools
import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

Vector = Float[np.ndarray, " dim"]
Square = Float[np.ndarray, "state state"]

State = Float[np.ndarray, " state"]
"""Position and, with inertia, velocity."""

ForceAt = Callable[[Vector], tuple[Vector, Float[np.ndarray, "dim dim"]]]
"""Mean force and its slope dF/dx at a position."""


@dataclasses.dataclass(frozen=True, eq=False)
class Transition:
    """A step, linearised.

    Attributes:
        slope: A, change of it by the state before.
        by_force: change of it by the force where that was asked for.
        noise: Q, covariance that the white noise adds.
    """

    state: State
    slope: Square
    by_force: Float[np.ndarray, "state dim"]
    noise: Square


class AbstractMotion(abc.ABC):
    """The known part of the dynamics: all but the force."""

    @abc.abstractmethod
    def start(
        self, position: Vector, sd: float, speed_sd: float
    ) -> tuple[State, Square]:
        """State at rest at a position [L], and its covariance.

        Args:
            position: [L].
            sd: standard deviation of each coordinate [L].
            speed_sd: the same of the velocity [L T⁻¹], where the state has one.
        """

    @abc.abstractmethod
    def step(
        self, state: State, force_at: ForceAt, thrust: Vector, duration: float
    ) -> Transition:
        """One step of the midpoint rule.

        Args:
            thrust: known acceleration, or velocity where there is no inertia.
            duration: h [T].
        """


@dataclasses.dataclass(frozen=True, eq=False)
class InertialMotion(AbstractMotion):
    r"""$\dot x = v$, $\dot v = -\gamma v + F(x) + u + \sigma\,\xi$; state (x, v).

    Attributes:
        damping: $\gamma$ [T⁻¹].
        noise: $\sigma$ [L T^-3/2].
    """

    damping: float
    noise: float

    def start(
        self, position: Vector, sd: float, speed_sd: float
    ) -> tuple[State, Square]:
        state = np.concatenate([position, np.zeros_like(position)])
        return state, np.diag(np.repeat([sd**2, speed_sd**2], len(position)))

    def step(
        self, state: State, force_at: ForceAt, thrust: Vector, duration: float
    ) -> Transition:
        h, dim = duration, len(thrust)
        x, v = state[:dim], state[dim:]
        middle = x + h / 2 * v
        force, gradient = force_at(middle)
        brake = self.damping * h / 2
        push, keep = h / (1 + brake), (1 - brake) / (1 + brake)
        later = keep * v + push * (force + thrust)
        identity = _identity(dim)
        by_place = push * gradient
        by_speed = keep * identity + h / 2 * by_place
        slope = np.empty((2 * dim, 2 * dim))
        slope[:dim, :dim] = identity + h / 2 * by_place
        slope[:dim, dim:] = h / 2 * (identity + by_speed)
        slope[dim:, :dim], slope[dim:, dim:] = by_place, by_speed
        return Transition(
            np.concatenate([middle + h / 2 * later, later]),
            slope,
            np.concatenate([h / 2 * push * identity, push * identity]),
            self.noise**2 * _integrated_noise(h, dim),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class OverdampedMotion(AbstractMotion):
    r"""$\dot x = F(x) + u + \sigma\,\xi$; F and u are velocities, the state is x.

    Attributes:
        noise: $\sigma$ [L T^-1/2].
    """

    noise: float

    def start(
        self, position: Vector, sd: float, speed_sd: float
    ) -> tuple[State, Square]:
        return np.array(position, float), sd**2 * np.eye(len(position))

    def step(
        self, state: State, force_at: ForceAt, thrust: Vector, duration: float
    ) -> Transition:
        h, identity = duration, _identity(len(state))
        middle = state + h / 2 * (force_at(state)[0] + thrust)
        force, gradient = force_at(middle)
        # The force on the way to the middle counts by its slope, to second order.
        by_force = h * (identity + h / 2 * gradient)
        return Transition(
            state + h * (force + thrust),
            identity + by_force @ gradient,
            by_force,
            self.noise**2 * h * identity,
        )


@functools.cache
def _identity(dim: int) -> Square:
    return np.eye(dim)


@functools.cache
def _integrated_noise(h: float, dim: int) -> Square:
    """Covariance of place and speed after a time h, for white noise of strength 1."""
    return np.kron(np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]]), np.eye(dim))


def substeps(elapsed: float, longest: float) -> tuple[int, float]:
    """Number of steps of an interval, none longer than `longest`, and their length."""
    count = max(math.ceil(elapsed / longest - 1e-6), 1)
    return count, elapsed / count
