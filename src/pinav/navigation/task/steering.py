r"""Swimmers that take commands: rotation frequency and heading.

A command is held from one control step to the next. It is the pair of the frequency f
of the rotating field [cycles T⁻¹] and the heading $\theta$ [rad], the angle of the
normal of the plane in which the field rotates to the x axis.
"""

import abc
import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.actuation import AbstractField, AbstractResponse, StepOutResponse
from pinav.arguments import Planar, Scalar, State, Vector, check_positive
from pinav.dynamics import RK4, FixedStep, OverdampedSwimmer, Swimmer
from pinav.forces import AbstractForce

Command = Float[Array, "2"]
"""Frequency [cycles T⁻¹] and heading [rad]."""


def direction(heading: Scalar) -> Planar:
    r"""Unit vector $n(\theta)$ of a heading [rad]."""
    heading = jnp.asarray(heading)
    return jnp.stack([jnp.cos(heading), jnp.sin(heading)])


class SteeringField(AbstractField):
    r"""Field that rotates about a heading in the plane, as coils make it.

    $$B(t) = B_0 (\cos(2\pi f t)\, \hat z + \sin(2\pi f t)\, n(\theta) \times \hat z).$$

    Attributes:
        amplitude: $B_0$ [B].
        frequency: $f$ [cycles T⁻¹].
        heading: $\theta$, of the normal of the plane of rotation [rad].
    """

    amplitude: Scalar
    frequency: Scalar
    heading: Scalar

    def __call__(self, t: Scalar) -> Float[Array, "3"]:
        phase = 2 * math.pi * self.frequency * jnp.asarray(t)
        across = jnp.asarray(self.heading) - math.pi / 2
        planar = self.amplitude * jnp.sin(phase) * direction(across)
        return jnp.append(planar, self.amplitude * jnp.cos(phase))


class AbstractActuator(eqx.Module):
    """What a command does to the swimmer."""

    @abc.abstractmethod
    def __call__(self, command: Command) -> Planar:
        """Thrust [L T⁻²] of a command: a velocity [L T⁻¹] where mobility is 1."""


class HelicalActuator(AbstractActuator):
    r"""Thrust $\alpha |m \times B|\, n(\theta)$ of a screw which the field turns.

    The screw turns with the field while the torque that this takes, $2\pi c f$, is
    below $m B_0$. Above the step-out frequency $f_c = m B_0 / 2\pi c$ it falls behind,
    and mean torque and thrust drop (`StepOutResponse`). The greatest thrust is that of
    the paper's swimmer, $\alpha m B_0$; here it can be steered.

    Attributes:
        gain: $\alpha$ [L⁻¹], thrust per torque.
        moment: $m$ [J B⁻¹ per mass], positive.
        amplitude: $B_0$ [B], positive.
        rotational_drag: $c$, torque per rate of rotation [L² T⁻¹ rad⁻¹], positive.

    Raises:
        InputError: `moment`, `amplitude` or `rotational_drag` is a number <= 0.

    References:
        PI-NAV paper, section 2.2, for the thrust; Adler, Proc. IRE 34, 351 (1946), for
        the step-out.
    """

    gain: Scalar
    moment: Scalar
    amplitude: Scalar
    rotational_drag: Scalar

    def __check_init__(self) -> None:
        check_positive(self, "moment", "amplitude", "rotational_drag")

    @property
    def step_out(self) -> Float[Array, ""]:
        """Frequency above which the screw falls behind the field [cycles T⁻¹]."""
        torque = jnp.asarray(self.moment * self.amplitude)
        return torque / (2 * math.pi * self.rotational_drag)

    def field(self, command: Command) -> SteeringField:
        """The field that a command stands for."""
        return SteeringField(self.amplitude, command[0], command[1])

    def __call__(self, command: Command) -> Planar:
        turning = StepOutResponse(self.step_out)(command[0])
        torque = 2 * math.pi * self.rotational_drag * turning
        return self.gain * torque * direction(command[1])


class RollingActuator(AbstractActuator):
    r"""Velocity $G\, s(f)\, n(\theta)$ of a robot that rolls, as in a recording's fit.

    Attributes:
        gain: $G$ [L per cycle].
        response: $s(f)$, the effective frequency.
    """

    gain: Float[Array, "2 2"]
    response: AbstractResponse

    def __call__(self, command: Command) -> Planar:
        return self.gain @ (self.response(command[0]) * direction(command[1]))


class HeldThrust(AbstractForce):
    """A thrust that holds: what a command is until the next one.

    Attributes:
        thrust: [L T⁻²].
    """

    thrust: Planar

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.thrust.astype(x.dtype)


class SteeredSwimmer(eqx.Module):
    """A swimmer whose propulsion follows commands.

    The truth, the fitted model and physics alone are one class with other dynamics.

    Attributes:
        dynamics: drag or mobility, environment and flow; commands replace its
            propulsion.
        actuator: what a command does.
    """

    dynamics: Swimmer | OverdampedSwimmer
    actuator: AbstractActuator

    def __call__(self, t: Scalar, y: State, command: Command) -> State:
        """Rate of change of the state `y` at time `t` [T] under a command."""
        return self.under(command)(t, y)

    def under(self, command: Command) -> Swimmer | OverdampedSwimmer:
        """The dynamics while a command holds."""
        return self.with_propulsion(HeldThrust(self.actuator(command)))

    def with_propulsion(self, thrust: AbstractForce) -> Swimmer | OverdampedSwimmer:
        """The dynamics with another propulsion."""
        # Not tree_at: the replaced propulsion may hold leaves under several names.
        return dataclasses.replace(self.dynamics, propulsion=thrust)

    def step(self, t: Scalar, y: State, command: Command, duration: Scalar) -> State:
        """State after a command was held for `duration` [T]; one Runge-Kutta step."""
        swimmer = self.under(command)
        return FixedStep(RK4).looped_step(swimmer, y, t, t + jnp.asarray(duration))


def greatest_thrust(
    actuator: AbstractActuator, limits: "CommandLimits"
) -> Float[Array, ""]:
    """Size of the thrust at the greatest frequency [L T⁻²], along x."""
    return jnp.linalg.norm(actuator(jnp.array([limits.max_frequency, 0.0])))


class CommandLimits(eqx.Module):
    """What coils and robot allow.

    Attributes:
        max_frequency: greatest frequency [cycles T⁻¹], positive.
        max_turning_rate: greatest rate of change of the heading [rad T⁻¹], positive;
            infinite means that coils turn at once.
        max_amplitude: greatest field [B], positive.

    Raises:
        InputError: a limit is not positive.
    """

    max_frequency: float
    max_turning_rate: float = math.inf
    max_amplitude: float = math.inf

    def __check_init__(self) -> None:
        check_positive(self, "max_frequency", "max_turning_rate", "max_amplitude")

    def clip(self, command: Command, previous: Command, duration: Scalar) -> Command:
        """The nearest allowed command after `previous` has held for `duration` [T]."""
        frequency = jnp.clip(command[0], 0.0, self.max_frequency)
        turn = jnp.mod(command[1] - previous[1] + math.pi, 2 * math.pi) - math.pi
        most = jnp.asarray(self.max_turning_rate * duration)
        return jnp.stack([frequency, previous[1] + jnp.clip(turn, -most, most)])
