"""The line of sight compensates a drift that it knows, and inverts actuators."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.navigate.line_of_sight import LineOfSight, command_of, cruising_speed
from tests.navigation.steering_worlds import DRAG, open_water

from pinav.actuation import SaturatingResponse
from pinav.forces import Advection, UniformFlow
from pinav.navigation.task import catalogue as tasks
from pinav.navigation.task.steering import CommandLimits, RollingActuator, physics_only
from pinav.navigation.task.task import ReachGoal
from pinav.navigation.trials.closed_loop import run

KEY = jax.random.key(0)
UNEQUAL = RollingActuator(
    jnp.array([[0.9, -0.2], [0.15, 1.1]]), SaturatingResponse(3.0)
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("actuator", "limits"),
    [
        (tasks.task("vortex").truth.actuator, tasks.task("vortex").limits),
        (UNEQUAL, CommandLimits(2.0)),
    ],
    ids=["screw", "unequal coils"],
)
def test_a_command_gives_the_thrust_that_it_was_asked_for(actuator, limits):
    angles = jnp.linspace(-3.0, 3.0, 7)
    wanted = 0.6 * jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1)
    made = jax.vmap(lambda w: actuator(command_of(actuator, limits, w)))(wanted)
    np.testing.assert_allclose(made, wanted, atol=3e-3)
    most = command_of(actuator, limits, jnp.array([9.0, 0.0]))
    np.testing.assert_allclose(most[0], limits.max_frequency)


def test_line_of_sight_is_straight_where_the_drift_is_known():
    drift = Advection(UniformFlow([0.0, 0.3]))
    task = open_water(environment=drift, objective=ReachGoal([1.5, 0.0], 0.1))
    known = run(task, LineOfSight.of(task, task.truth), key=KEY)
    blind = run(task, LineOfSight.of(task, physics_only(task.truth)), key=KEY)
    assert np.abs(known.states[:, 1]).max() < 0.05
    assert np.abs(blind.states[:, 1]).max() > 0.1


def test_cruising_speed_is_thrust_over_drag():
    """The environment and the flow do not count."""
    task = open_water(inert=True)
    speed = cruising_speed(task.truth, task)
    np.testing.assert_allclose(speed, 1 / DRAG)
    carried = open_water(environment=Advection(UniformFlow([0.0, 0.3])))
    speed = cruising_speed(carried.truth, carried)
    np.testing.assert_allclose(speed, 1.0)
