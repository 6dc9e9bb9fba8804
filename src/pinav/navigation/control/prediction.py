"""Courses: what a model says will follow from a sequence of thrusts."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.errors import InputError
from pinav.navigation.control.controller import Observation
from pinav.navigation.model.predictors import AbstractPredictor, Drive
from pinav.navigation.planning.plan import TimeToGo


class Courses(eqx.Module):
    """Predictions of a fixed number of steps.

    Attributes:
        predictor: the model.
        drive: commands as shares of the greatest thrust.
        step: how long a command holds [T].
        steps: how many are predicted, positive.

    Raises:
        InputError: `steps` is not positive.
    """

    predictor: AbstractPredictor
    drive: Drive
    step: float = eqx.field(static=True)
    steps: int = eqx.field(static=True, default=20)

    def __check_init__(self):
        if self.steps < 1:
            raise InputError(f"Courses.steps: expected >= 1, got {self.steps}")

    def __call__(
        self, observation: Observation, shares: Float[Array, "step 2"]
    ) -> tuple[Float[Array, " time"], Float[Array, "time state"]]:
        """Times [T] and states of the course of a sequence of thrust shares."""
        y0, previous = observation.state, observation.pending[-1]
        ts = observation.time + self.step * jnp.arange(
            shares.shape[0] + 1, dtype=y0.dtype
        )

        def move(carry, inputs):
            y, previous = carry
            t, share = inputs
            command = self.drive.command(share, previous, self.step)
            y = self.predictor.step(t, y, command, self.step)
            return (y, command), y

        _, ys = jax.lax.scan(move, (y0, previous), (ts[:-1], shares))
        return ts, jnp.concatenate([y0[None], ys])

    def command(
        self, observation: Observation, share: Float[Array, "2"]
    ) -> Float[Array, "2"]:
        """The command now for a thrust share."""
        return self.drive.command(share, observation.pending[-1], self.step)


class AbstractGuide(eqx.Module):
    """Proposes a sequence of thrusts."""

    @abc.abstractmethod
    def __call__(
        self, observation: Observation, courses: Courses
    ) -> Float[Array, "step 2"]:
        """Thrust shares for the steps of a course."""


class Downhill(AbstractGuide):
    """Always to where the time-to-go is least a step of the plan later.

    Attributes:
        plan: the time-to-go.
    """

    plan: TimeToGo

    def __call__(self, observation, courses):
        def move(carry, t):
            y, previous = carry
            share = self.plan.share(t, y, previous, courses.predictor)
            command = courses.drive.command(share, previous, courses.step)
            y = courses.predictor.step(t, y, command, courses.step)
            return (y, command), share

        dtype = observation.state.dtype
        ts = observation.time + courses.step * jnp.arange(courses.steps, dtype=dtype)
        begin = (observation.state, observation.pending[-1])
        return jax.lax.scan(move, begin, ts)[1]
