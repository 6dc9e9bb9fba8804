r"""The controller of a task, and what wraps it: for delays and noisy sensors.

Each wrapper gives the controller inside a better observation: the state when the
command will come into force, or the one that explains what was seen.
"""

from collections.abc import Sequence
from typing import Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from pinav.arguments import Scalar, State
from pinav.navigation.control.controller import (
    AbstractController,
    ArrivalCost,
    GradientGuide,
    Observation,
    TrackingCost,
    TrajectoryPrediction,
)
from pinav.navigation.control.mppi import GradientMPC, PathIntegral
from pinav.navigation.planning.plan import check_places, time_to_go
from pinav.navigation.predictors import AbstractPredictor, tabulate_model
from pinav.navigation.task.steering import Command, SteeredSwimmer
from pinav.navigation.task.task import ReachGoal, Task, Timing


def controller(
    task: Task, model: SteeredSwimmer, *, samples: Sequence[SteeredSwimmer] = ()
) -> AbstractController:
    """Plan and control a task with a model: the truth of the task is not used.

    To reach a place: path integral control towards the plan's time-to-go. To follow a
    path: shooting. Both inside a filter where the task has a noisy sensor, and a
    compensation of the delay if there is one.

    Args:
        model: what is believed: a fitted model, physics alone, or the truth.
        samples: of the model's posterior, none or at least two: where they disagree,
            time costs more.

    Raises:
        InputError: the task cannot be done with the model: see `time_to_go`.
    """
    check_places(task)
    tables = tabulate_model(task, model, samples=samples)
    predictor = tables.predictor

    def predict(steps: int) -> TrajectoryPrediction:
        return TrajectoryPrediction(predictor, tables.control_map, task.step, steps)

    steered: AbstractController
    if isinstance(task.objective, ReachGoal):
        plan = time_to_go(task, model, tables=tables)
        steered = PathIntegral(predict(STEPS), ArrivalCost(plan), GradientGuide(plan))
    else:
        cost = TrackingCost(task.objective, tables.time_cost)
        steered = GradientMPC(predict(TRACKING_STEPS), cost)
    # The filter stands outside: it must see observations as they are, not ahead.
    if task.delay > 0:
        steered = DelayCompensation(steered, predictor, task.timing)
    if task.sensor_noise > 0:
        steered = StateEstimation(
            steered,
            predictor,
            task.timing,
            noise=task.noise,
            sensor_noise=task.sensor_noise,
            dim=task.dim,
        )
    return steered


STEPS = 20
"""Steps that the control of an arrival looks ahead."""

TRACKING_STEPS = 10
"""Steps that the control of a path looks ahead."""


Inner = TypeVar("Inner", bound=PyTree)


def predict_onset(
    predictor: AbstractPredictor, timing: Timing, observation: Observation
) -> Observation:
    """The observation when the next command comes into force."""
    pending = observation.pending
    durations = jnp.full(pending.shape[0], timing.step).at[0].set(timing.remainder)

    def move(
        carry: tuple[Scalar, State], inputs: tuple[Command, Scalar]
    ) -> tuple[tuple[Scalar, State], None]:
        t, y = carry
        command, duration = inputs
        return (t + duration, predictor.step(t, y, command, duration)), None

    time = jnp.asarray(observation.time, observation.state.dtype)
    begin = (time, observation.state)
    (t, y), _ = jax.lax.scan(move, begin, (pending, durations))
    return Observation(t, y, pending[-1:])


class DelayCompensation(AbstractController[Inner], Generic[Inner]):
    """Lets a controller decide for the moment when its command comes into force.

    Until then the swimmer does what was commanded before: a model says where it will
    be. Without noise, and with a true model, the delay then costs nothing but its first
    moments.
    """

    controller: AbstractController[Inner]
    predictor: AbstractPredictor
    timing: Timing

    def start(self, observation: Observation) -> Inner:
        return self.controller.start(
            predict_onset(self.predictor, self.timing, observation)
        )

    def __call__(
        self, observation: Observation, memory: Inner, *, key: PRNGKeyArray
    ) -> tuple[Command, Inner]:
        ahead = predict_onset(self.predictor, self.timing, observation)
        return self.controller(ahead, memory, key=key)


class FilterState(eqx.Module, Generic[Inner]):
    """Memory of a filter.

    Attributes:
        command: the one in force when it was observed.
        time: time of the last observation [T].
    """

    mean: State
    covariance: Float[Array, "state state"]
    command: Command
    time: Float[Array, ""]
    inner: Inner


class StateEstimation(AbstractController[FilterState[Inner]], Generic[Inner]):
    r"""Estimates the state from noisy observations, by an extended Kalman filter.

    Attributes:
        noise: strength of the white noise, as in `Task`.
        sensor_noise: standard deviation of each observed component.
        dim: components of the velocity, or without inertia of the position.

    References:
        Jazwinski, Stochastic Processes and Filtering Theory (1970), ch. 8.
    """

    controller: AbstractController[Inner]
    predictor: AbstractPredictor
    timing: Timing
    noise: float
    sensor_noise: float
    dim: int = eqx.field(static=True, default=2)

    def start(self, observation: Observation) -> FilterState[Inner]:
        mean = observation.state
        covariance = jnp.diag(jnp.full(len(mean), self.sensor_noise**2, mean.dtype))
        time = jnp.asarray(observation.time, mean.dtype)
        inner = self.controller.start(Observation(time, mean, observation.pending))
        return FilterState(mean, covariance, observation.pending[0], time, inner)

    def __call__(
        self, observation: Observation, memory: FilterState[Inner], *, key: PRNGKeyArray
    ) -> tuple[Command, FilterState[Inner]]:
        mean, covariance = self._update(observation, memory)
        observed = Observation(observation.time, mean, observation.pending)
        command, inner = self.controller(observed, memory.inner, key=key)
        time = jnp.asarray(observation.time, mean.dtype)
        belief = FilterState(mean, covariance, observation.pending[0], time, inner)
        return command, belief

    def _update(
        self, observation: Observation, memory: FilterState[Inner]
    ) -> tuple[State, Float[Array, "state state"]]:
        """Mean and covariance after an observation; as they were at the first one."""
        mean, covariance = self._predict(observation, memory)
        error = self.sensor_noise**2 + LEAST * jnp.diag(covariance)
        gain = jnp.linalg.solve(covariance + jnp.diag(error), covariance).T
        new = mean + gain @ (observation.state - mean)
        spread = covariance - gain @ covariance
        # Rounding makes the difference lopsided, and later steps would amplify that.
        spread = (spread + spread.T) / 2
        first = observation.time <= memory.time
        return (
            jnp.where(first, memory.mean, new),
            jnp.where(first, memory.covariance, spread),
        )

    def _predict(
        self, observation: Observation, memory: FilterState[Inner]
    ) -> tuple[State, Float[Array, "state state"]]:
        """Mean and covariance one step on, under the commands that were in force."""
        first, second = self.timing.remainder, self.timing.rest

        def onward(mean: State) -> tuple[State, State]:
            t, moved = memory.time, mean
            if first > 0:
                moved = self.predictor.step(t, moved, memory.command, first)
            if second > 0:
                command = observation.pending[0]
                moved = self.predictor.step(t + first, moved, command, second)
            return moved, moved

        # Forward mode, for few inputs; the step itself comes out beside its slope.
        slope, mean = jax.jacfwd(onward, has_aux=True)(memory.mean)
        moved = jnp.arange(len(mean)) >= len(mean) - self.dim
        kicks = jnp.where(moved, self.noise**2 * self.timing.step, 0.0)
        return mean, slope @ memory.covariance @ slope.T + jnp.diag(kicks)


LEAST = 1e-6
"""Share of its variance that is added to each component, so that matrices can be
inverted, whatever the units."""
