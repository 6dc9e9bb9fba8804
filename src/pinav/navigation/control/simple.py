r"""What a learned model has to beat: simple controllers, and other models.

Physics alone and the oracle are any controller with another model: `physics_only`, and
the truth of the task.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from pinav.arguments import Planar, Scalar, State
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.navigation.control.controller import AbstractController, Observation
from pinav.navigation.task.objectives import AbstractObjective
from pinav.navigation.task.steering import (
    AbstractActuator,
    Command,
    CommandLimits,
    SteeredSwimmer,
    greatest_thrust,
)
from pinav.navigation.task.task import Task

TABULATED = 129
"""Frequencies at which the thrust is tabulated, to find that of a wanted thrust."""

TURNS = 4
"""Corrections of a heading, for actuators whose thrust is not along it."""

REACTION = 0.5
"""Time in which a swimmer with inertia is to take the wanted velocity [T]."""


class StraightLine(AbstractController[tuple[()]]):
    """Straight to the target with all thrust, whatever is in between.

    Attributes:
        objective: what is to be done.
        limits: what may be commanded.
    """

    objective: AbstractObjective
    limits: CommandLimits

    def start(self, observation: Observation) -> tuple[()]:
        return ()

    def __call__(
        self, observation: Observation, memory: tuple[()], *, key: PRNGKeyArray
    ) -> tuple[Command, tuple[()]]:
        offset = self.objective.target(observation.time) - observation.state[:2]
        heading = jnp.arctan2(offset[1], offset[0])
        frequency = jnp.full_like(heading, self.limits.max_frequency)
        return jnp.stack([frequency, heading]), ()


class LineOfSight(AbstractController[tuple[()]]):
    r"""Line of sight with compensation of the modelled drift.

    Without inertia the thrust is $v_{ref} - u(x)$, with the velocity u that the model
    has without thrust; with inertia it is $(v_{ref} - v) / \tau - a(x, v)$, with the
    acceleration a. Where that is more than there is, it is shortened.

    Attributes:
        objective: gives the reference velocity.
        model: what is known, or was learned.
        limits: what may be commanded.
        speed: of the reference where the swimmer is in a hurry [L T⁻¹].
    """

    objective: AbstractObjective
    model: SteeredSwimmer
    limits: CommandLimits
    speed: Scalar

    @classmethod
    def of(cls, task: Task, model: SteeredSwimmer) -> "LineOfSight":
        """For a task, at the speed that the greatest thrust keeps up."""
        speed = cruising_speed(model, task.limits, task.start)
        return cls(task.objective, model, task.limits, speed)

    def start(self, observation: Observation) -> tuple[()]:
        return ()

    def __call__(
        self, observation: Observation, memory: tuple[()], *, key: PRNGKeyArray
    ) -> tuple[Command, tuple[()]]:
        t, y = observation.time, observation.state
        rate = self.objective.guidance(t, y[:2], self.speed)
        if y.shape[0] > 2:
            rate = (rate - y[2:]) / REACTION
        thrust = rate - self.model(t, y, jnp.zeros_like(y[:2]))[-2:]
        return command_of(self.model.actuator, self.limits, thrust), ()


def cruising_speed(
    model: SteeredSwimmer, limits: CommandLimits, state: State
) -> Float[Array, ""]:
    """Speed that the greatest thrust keeps up against drag alone [L T⁻¹].

    Args:
        model: the swimmer.
        limits: what may be commanded.
        state: at which the drag is taken.
    """
    thrust = greatest_thrust(model.actuator, limits)
    if state.shape[0] == 2:
        return thrust
    idle = physics_only(model).under(jnp.zeros(2, state.dtype))
    slopes = jax.jacfwd(lambda v: idle(0.0, jnp.append(state[:2], v))[2:])(state[2:])
    # The mean of both directions: the tensor of an anisotropic drag has no single one.
    return thrust / (-jnp.trace(slopes) / 2)


def command_of(
    actuator: AbstractActuator, limits: CommandLimits, thrust: Planar
) -> Command:
    """The command whose thrust is the wanted one, or the nearest in its direction.

    Args:
        actuator: its thrust must grow with the frequency up to the limit.
        limits: what may be commanded.
        thrust: wanted [L T⁻²].
    """
    frequencies = jnp.linspace(0.0, limits.max_frequency, TABULATED, dtype=thrust.dtype)
    toward = jnp.arctan2(thrust[1], thrust[0])

    def correct(_: Int[Array, ""], heading: Float[Array, ""]) -> Float[Array, ""]:
        made = actuator(jnp.stack([frequencies[-1], heading]))
        return heading + toward - jnp.arctan2(made[1], made[0])

    # A fixed number of corrections, so that it can be batched and differentiated.
    heading = jax.lax.fori_loop(0, TURNS, correct, toward)
    thrusts = jax.vmap(lambda f: actuator(jnp.stack([f, heading])))(frequencies)
    sizes = jnp.linalg.norm(thrusts, axis=1)
    frequency = jnp.interp(jnp.linalg.norm(thrust), sizes, frequencies)
    return jnp.stack([frequency, heading])


def steered_swimmer(
    task: Task, dynamics: Swimmer | OverdampedSwimmer
) -> SteeredSwimmer:
    """Fitted dynamics under the commands of a task."""
    return SteeredSwimmer(dynamics, task.truth.actuator)


def physics_only(model: SteeredSwimmer) -> SteeredSwimmer:
    """The model without its environment."""
    return SteeredSwimmer(model.dynamics.without_environment(), model.actuator)
