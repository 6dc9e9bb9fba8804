"""Controllers, the courses that they predict, and what these cost."""

import abc
from typing import Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from pinav.arguments import Scalar, State, Vector
from pinav.errors import InputError
from pinav.navigation import predictors
from pinav.navigation.planning.plan import TimeToGo
from pinav.navigation.task.steering import Command, CommandLimits, direction_angles
from pinav.navigation.task.task import AbstractObjective

Controls = Float[Array, "step dim"]
"""Thrusts of the coming steps, in units of the greatest one."""

Memory = TypeVar("Memory")


class Observation(eqx.Module):
    """The information that a controller gets at a control step.

    Attributes:
        time: now [T].
        state: the state, with the error of the sensor.
        pending: commands that were given and have not come into force, the oldest
            first; the oldest is in force now. One row where there is no delay: the
            command in force until now.
    """

    time: Scalar
    state: State
    pending: Float[Array, "command dim"]


class AbstractController(eqx.Module, Generic[Memory]):
    """A pure function from observation and memory to command and memory.

    It can be jitted, scanned over time and mapped over seeds.
    """

    @abc.abstractmethod
    def start(self, observation: Observation) -> Memory:
        """Memory before the first step."""

    @abc.abstractmethod
    def __call__(
        self, observation: Observation, memory: Memory, *, key: PRNGKeyArray
    ) -> tuple[Command, Memory]:
        """Command for the coming step, not yet clipped, and memory for the next."""


class StraightLine(AbstractController[tuple[()]]):
    """Straight to the target with all thrust, whatever is in between."""

    objective: AbstractObjective
    limits: CommandLimits

    def start(self, observation: Observation) -> tuple[()]:
        return ()

    def __call__(
        self, observation: Observation, memory: tuple[()], *, key: PRNGKeyArray
    ) -> tuple[Command, tuple[()]]:
        target = self.objective.target(observation.time)
        offset = target - observation.state[: target.shape[0]]
        frequency = jnp.full((1,), self.limits.max_frequency, offset.dtype)
        return jnp.concatenate([frequency, direction_angles(offset)]), ()


class TrajectoryPrediction(eqx.Module):
    """Predictions of a fixed number of steps.

    Attributes:
        step: how long a command holds [T].
        steps: how many are predicted, positive.

    Raises:
        InputError: `steps` is not positive.
    """

    predictor: predictors.AbstractPredictor
    control_map: predictors.ControlMap
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


class GradientGuide(eqx.Module):
    """Always to where the time-to-go is least a step of the plan later."""

    plan: TimeToGo

    def __call__(
        self, observation: Observation, prediction: TrajectoryPrediction
    ) -> Controls:
        """Controls for the steps of a prediction."""

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


Times = Float[Array, " time"]
"""Times [T], the first of which is now."""

Course = Float[Array, "time state"]
"""States at these times."""


class AbstractCost(eqx.Module):
    """The cost of a course of states; no batch axis."""

    @abc.abstractmethod
    def __call__(self, ts: Times, ys: Course, controls: Controls) -> Float[Array, ""]:
        """Cost of a course."""


class ArrivalCost(AbstractCost):
    """Time until the goal is reached; after the last state that of the plan [T].

    Each unit of time costs what `TimeCost` says, and each step into a wall the
    time limit of the task.
    """

    plan: TimeToGo

    def __call__(self, ts: Times, ys: Course, controls: Controls) -> Float[Array, ""]:
        plan = self.plan
        xs = ys[:, : plan.goal.shape[0]]
        fraction = jax.vmap(predictors.entry_fraction, (0, 0, None, None))(
            xs[:-1], jnp.diff(xs, axis=0), plan.goal, plan.tolerance
        )
        # One until the goal is entered, zero ever after: what follows costs nothing.
        away = jnp.cumprod(jnp.isinf(fraction).astype(ys.dtype))
        before = jnp.concatenate([jnp.ones_like(away[:1]), away[:-1]])
        time_cost = plan.tables.time_cost
        running_cost = jax.vmap(time_cost.running_cost)(ts[1:], xs[1:])
        running_cost = running_cost + _collisions(time_cost, xs) * plan.horizon
        running = before * jnp.minimum(fraction, 1.0) * jnp.diff(ts) * running_cost
        return jnp.sum(running) + away[-1] * plan.at(ys[-1], ts[-1])


class TrackingCost(AbstractCost):
    r"""Mean square distance from the target, $\int |x - r(t)|^2 dt$ [L² T].

    Attributes:
        objective: the target r.
        time_cost: walls; what time costs more near them is added.
        effort: weight of the squared change of the control from step to step.
    """

    objective: AbstractObjective
    time_cost: predictors.TimeCost
    effort: float = 0.0

    def __call__(self, ts: Times, ys: Course, controls: Controls) -> Float[Array, ""]:
        xs = ys[:, : self.time_cost.arena.dim]
        targets = jax.vmap(self.objective.target)(ts[1:])
        error = jnp.sum((xs[1:] - targets) ** 2, axis=1)
        running_cost = jax.vmap(self.time_cost.running_cost)(ts[1:], xs[1:]) - 1
        walls = running_cost + COLLISION * _collisions(self.time_cost, xs)
        change = jnp.sum(jnp.diff(controls, axis=0) ** 2)
        return jnp.sum((error + walls) * jnp.diff(ts)) + self.effort * change


COLLISION = 1e3
"""Cost of a unit of time in a wall, where a path is followed [L²]."""


def _collisions(
    time_cost: predictors.TimeCost, xs: Float[Array, "time dim"]
) -> Float[Array, " step"]:
    """One for each later position in a wall."""
    clearance = jax.vmap(time_cost.clearance)(xs[1:])
    return (clearance < 0).astype(xs.dtype)
