"""The known motion of a swimmer, as a belief takes it."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.navigation.belief.belief import Belief, Frame
from pinav.navigation.belief.kernel_filter import KernelFilter
from pinav.navigation.belief.motion import (
    AbstractMotion,
    InertialMotion,
    OverdampedMotion,
    Vector,
)
from pinav.navigation.model.predictors import InertialTable
from pinav.navigation.model.tables import FieldTable
from pinav.navigation.model.tabulated import TabulatedModel
from pinav.navigation.task.task import Task


def motion_of(task: Task, physics: TabulatedModel) -> AbstractMotion:
    """The motion of a belief: its drag is the mean over arena and directions."""
    if isinstance(physics.predictor, InertialTable):
        drag = np.asarray(physics.table.values[0, ..., 2:]).reshape(-1, 2, 2)
        return InertialMotion(float(np.mean(np.trace(drag.T))) / 2, task.noise)
    return OverdampedMotion(task.noise)


def with_known(frame: Frame, belief: Belief, physics: TabulatedModel) -> Frame:
    """A frame whose thrust is all that is known of the rate since the last one."""
    elapsed = frame.time - belief.time
    rate = known_rate(belief.best, frame.thrust, elapsed, physics)
    return dataclasses.replace(frame, thrust=rate)


def known_rate(
    before: KernelFilter, thrust: Vector, elapsed: float, physics: TabulatedModel
) -> Vector:
    r"""Known rate of the velocity, or of the position without inertia.

    A table of the known physics holds the rate at rest a and a matrix D or M at each
    place. With the thrust u and the drag $\gamma$ of the motion, the known rate is
    $a + u - (D - \gamma)\,v$ with inertia and $a + M u$ without, at the middle of the
    way as it was believed.
    """
    motion, state = before.motion, before.state
    dim = motion.dim_of(state)
    inertial = isinstance(motion, InertialMotion)
    velocity = state[dim:] if inertial else np.zeros(dim)
    middle = state[:dim] + velocity * elapsed / 2
    values = np.asarray(_at(physics.table, jnp.asarray(middle)), float)
    rate, matrix = values[:dim], values[dim:].reshape(dim, dim)
    if inertial:
        return rate + thrust - (matrix - motion.damping * np.eye(dim)) @ velocity
    return rate + matrix @ thrust


@eqx.filter_jit
def _at(table: FieldTable, x: Float[Array, " dim"]) -> Float[Array, " channel"]:
    return table(jnp.zeros(()), x)
