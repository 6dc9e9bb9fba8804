"""A navigation task."""

import equinox as eqx
import numpy as np

from pinav.arguments import State, real_array
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.navigation.task.objectives import AbstractObjective
from pinav.navigation.task.steering import CommandLimits, SteeredSwimmer
from pinav.navigation.task.zones import AbstractZone, Rectangle


class Task(eqx.Module):
    """A true swimmer in a true environment, and what it is asked to do.

    The controller knows all of this but `truth`, of which it has a model.

    Attributes:
        name: what the command line calls it.
        truth: the swimmer and its surroundings.
        start: its first state.
        objective: what is to be done.
        limits: what may be commanded.
        arena: what must not be left.
        keep_out: what must not be entered.
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

    @property
    def inertial(self) -> bool:
        """True where the state holds a velocity."""
        return self.start.shape[0] > self.dim


def steered_swimmer(
    task: Task, dynamics: Swimmer | OverdampedSwimmer
) -> SteeredSwimmer:
    """Fitted dynamics under the commands of a task."""
    return SteeredSwimmer(dynamics, task.truth.actuator)
