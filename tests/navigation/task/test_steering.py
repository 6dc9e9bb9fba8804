"""Other models than a learned one."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from pinav.navigation.task import catalogue as tasks
from pinav.navigation.task.steering import physics_only


def test_physics_alone_has_no_environment():
    task = tasks.task("barrier-weak")
    at = jnp.array([3.0, 4.0, 0.5, -1.0])
    alone = physics_only(task.truth)(0.0, at, jnp.zeros(2))
    np.testing.assert_allclose(alone, [0.5, -1.0, -0.18, 0.36])
    assert eqx.tree_equal(physics_only(task.truth).actuator, task.truth.actuator)
