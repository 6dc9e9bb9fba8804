"""What is known of a swimmer's motion, as a belief takes it."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.navigation.belief.belief import Belief, Frame
from pinav.navigation.belief.motion import InertialMotion, OverdampedMotion
from pinav.navigation.model.predictors import InertialTable
from pinav.navigation.model.tables import FieldTable
from pinav.navigation.model.tabulated import TabulatedModel
from pinav.navigation.task.task import Task


def motion_of(task: Task, physics: TabulatedModel) -> InertialMotion | OverdampedMotion:
    """The motion of a belief: its drag is the mean over arena and directions.

    Args:
        task: which states the noise.
        physics: tables without the environment.
    """
    if isinstance(physics.predictor, InertialTable):
        drag = np.asarray(physics.table.values[0, ..., 2:]).reshape(-1, 2, 2)
        return InertialMotion(float(np.mean(np.trace(drag.T))) / 2, task.noise)
    return OverdampedMotion(task.noise)


def with_known(frame: Frame, belief: Belief, physics: TabulatedModel) -> Frame:
    r"""A frame whose thrust is all that is known of the rate since the last one.

    A table of the known physics holds the rate at rest a and a matrix D or M at each
    place. With the thrust u and the drag $\gamma$ of the motion, the known rate is
    $a + u - (D - \gamma)\,v$ with inertia and $a + M u$ without, at the middle of the
    way as it was believed.

    Args:
        frame: with the mean thrust since the last one.
        belief: before it.
        physics: tables without the environment.
    """
    assert frame.position is not None
    state, dim = belief.state.mean, len(frame.position)
    motion = belief.best.motion
    inertial = isinstance(motion, InertialMotion)
    velocity = state[dim:] if inertial else np.zeros(dim)
    middle = state[:dim] + velocity * (frame.time - belief.time) / 2
    values = np.asarray(_at(physics.table, jnp.asarray(middle)), float)
    rate, matrix = values[:dim], values[dim:].reshape(dim, dim)
    if inertial:
        rate = rate + frame.thrust - (matrix - motion.damping * np.eye(dim)) @ velocity
    else:
        rate = rate + matrix @ frame.thrust
    return dataclasses.replace(frame, thrust=rate)


@eqx.filter_jit
def _at(table: FieldTable, x: Float[Array, " dim"]) -> Float[Array, " channel"]:
    return table(jnp.zeros(()), x)
