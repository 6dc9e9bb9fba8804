"""TrajectoryPrediction: what a model says will follow from a sequence of thrusts."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.arguments import Scalar, State, Vector
from pinav.errors import InputError
from pinav.navigation.control.controller import Controls, Observation
from pinav.navigation.model.predictors import AbstractPredictor, ControlMap
from pinav.navigation.planning.plan import TimeToGo
from pinav.navigation.task.steering import Command


class TrajectoryPrediction(eqx.Module):
    """Predictions of a fixed number of steps.

    Attributes:
        predictor: the model.
        control_map: what command a control stands for.
        step: how long a command holds [T].
        steps: how many are predicted, positive.

    Raises:
        InputError: `steps` is not positive.
    """

    predictor: AbstractPredictor
    control_map: ControlMap
    step: float = eqx.field(static=True)
    steps: int = eqx.field(static=True, default=20)

    def __check_init__(self) -> None:
        if self.steps < 1:
            raise InputError(
                f"TrajectoryPrediction.steps: expected >= 1, got {self.steps}"
            )

    def __call__(
        self, observation: Observation, controls: Controls
    ) -> tuple[Float[Array, " time"], Float[Array, "time state"]]:
        """Times [T] and states that follow from a sequence of controls."""
        y0, previous = observation.state, observation.pending[-1]
        # By multiples, not by a running sum: times then agree with those of the trial.
        ts = observation.time + self.step * jnp.arange(
            controls.shape[0] + 1, dtype=y0.dtype
        )

        def move(
            carry: tuple[State, Command], inputs: tuple[Scalar, Vector]
        ) -> tuple[tuple[State, Command], State]:
            y, previous = carry
            t, control = inputs
            command = self.control_map.command(control, previous, self.step)
            y = self.predictor.step(t, y, command, self.step)
            return (y, command), y

        _, ys = jax.lax.scan(move, (y0, previous), (ts[:-1], controls))
        return ts, jnp.concatenate([y0[None], ys])

    def command(self, observation: Observation, control: Vector) -> Command:
        """The command now that a control stands for."""
        return self.control_map.command(control, observation.pending[-1], self.step)


class AbstractGuide(eqx.Module):
    """Proposes a sequence of thrusts."""

    @abc.abstractmethod
    def __call__(
        self, observation: Observation, prediction: TrajectoryPrediction
    ) -> Controls:
        """Controls for the steps of a prediction."""


class GradientGuide(AbstractGuide):
    """Always to where the time-to-go is least a step of the plan later.

    Attributes:
        plan: the time-to-go.
    """

    plan: TimeToGo

    def __call__(
        self, observation: Observation, prediction: TrajectoryPrediction
    ) -> Controls:
        def move(
            carry: tuple[State, Command], t: Scalar
        ) -> tuple[tuple[State, Command], Vector]:
            y, previous = carry
            control = self.plan.control(t, y, previous, prediction.predictor)
            command = prediction.control_map.command(control, previous, prediction.step)
            y = prediction.predictor.step(t, y, command, prediction.step)
            return (y, command), control

        dtype = observation.state.dtype
        ts = observation.time + prediction.step * jnp.arange(
            prediction.steps, dtype=dtype
        )
        begin = (observation.state, observation.pending[-1])
        return jax.lax.scan(move, begin, ts)[1]
