r"""A controller that a plan has to beat: the line of sight, less the modelled drift."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from pinav.arguments import Scalar, Vector
from pinav.navigation.control.controller import AbstractController, Observation
from pinav.navigation.task.steering import (
    AbstractActuator,
    Command,
    CommandLimits,
    SteeredSwimmer,
    direction_angles,
    greatest_thrust,
    physics_only,
)
from pinav.navigation.task.task import AbstractObjective, FollowPath, Task

CATCH_UP = 0.5
"""Time in which an offset from a path is made up for [T]."""

TABULATED = 129
"""Frequencies at which the thrust is tabulated, to find that of a wanted thrust."""

TURNS = 4
"""Corrections of a heading, for actuators whose thrust is not along it."""

REACTION = 0.5
"""Time in which a swimmer with inertia is to take the wanted velocity [T]."""


def reference_velocity(
    objective: AbstractObjective, t: Scalar, x: Vector, speed: Scalar
) -> Vector:
    """Velocity that leads to the target along the line of sight [L T⁻¹].

    Args:
        objective: what is to be done.
        t: now [T].
        x: position [L].
        speed: speed of a swimmer in a hurry [L T⁻¹].
    """
    if isinstance(objective, FollowPath):
        t = jnp.asarray(t, x.dtype)
        target, velocity = jax.jvp(objective.path, (t,), (jnp.ones_like(t),))
        return velocity + (target - x) / CATCH_UP
    offset = objective.target(t) - x
    return speed * offset / jnp.maximum(jnp.linalg.norm(offset), 1e-12)


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
        speed = cruising_speed(model, task)
        return cls(task.objective, model, task.limits, speed)

    def start(self, observation: Observation) -> tuple[()]:
        return ()

    def __call__(
        self, observation: Observation, memory: tuple[()], *, key: PRNGKeyArray
    ) -> tuple[Command, tuple[()]]:
        t, y = observation.time, observation.state
        dim = observation.pending.shape[1]
        rate = reference_velocity(self.objective, t, y[:dim], self.speed)
        if y.shape[0] > dim:
            rate = (rate - y[dim:]) / REACTION
        thrust = rate - self.model(t, y, jnp.zeros_like(y[:dim]))[-dim:]
        return command_of(self.model.actuator, self.limits, thrust), ()


def cruising_speed(model: SteeredSwimmer, task: Task) -> Float[Array, ""]:
    """Speed that the greatest thrust keeps up against drag alone [L T⁻¹].

    Args:
        model: the swimmer.
        task: its limits, and the start, at which the drag is taken.
    """
    dim, state = task.dim, task.start
    thrust = greatest_thrust(model.actuator, task.limits, dim)
    if not task.inertial:
        return thrust
    idle = physics_only(model).under(jnp.zeros(dim, state.dtype))
    slopes = jax.jacfwd(lambda v: idle(0.0, jnp.append(state[:dim], v))[dim:])(
        state[dim:]
    )
    # The mean of all directions: the tensor of an anisotropic drag has no single one.
    return thrust / (-jnp.trace(slopes) / dim)


def command_of(
    actuator: AbstractActuator, limits: CommandLimits, thrust: Vector
) -> Command:
    """The command whose thrust is the wanted one, or the nearest in its direction.

    Args:
        actuator: its thrust must grow with the frequency up to the limit.
        limits: what may be commanded.
        thrust: wanted [L T⁻²].
    """
    frequencies = jnp.linspace(0.0, limits.max_frequency, TABULATED, dtype=thrust.dtype)
    toward = direction_angles(thrust)

    def made(frequency: Scalar, angles: Float[Array, " angle"]) -> Vector:
        return actuator(jnp.append(frequency, angles))

    def correct(
        _: Int[Array, ""], angles: Float[Array, " angle"]
    ) -> Float[Array, " angle"]:
        return angles + toward - direction_angles(made(frequencies[-1], angles))

    # A fixed number of corrections, so that it can be batched and differentiated.
    angles = jax.lax.fori_loop(0, TURNS, correct, toward)
    thrusts = jax.vmap(lambda frequency: made(frequency, angles))(frequencies)
    sizes = jnp.linalg.norm(thrusts, axis=1)
    frequency = jnp.interp(jnp.linalg.norm(thrust), sizes, frequencies)
    return jnp.append(frequency, angles)
