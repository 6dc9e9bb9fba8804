"""Every task can be begun, and is as hard as it says."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.dynamics import Swimmer
from pinav.errors import InputError
from pinav.navigation.control.controller import StraightLine
from pinav.navigation.task import catalogue as tasks
from pinav.navigation.task.steering import greatest_thrust, physics_only
from pinav.navigation.task.task import FollowPath, ReachGoal
from pinav.navigation.trials.closed_loop import run_many
from pinav.navigation.trials.situation import begin
from pinav.scenarios import scenario

KEYS = jax.random.split(jax.random.key(5), 20)


@pytest.mark.parametrize("name", tasks.TASKS)
def test_every_task_fits_together(name):
    task = tasks.task(name)
    assert task.name == name
    assert begin(task).clearance > 0
    rate = task.truth(0.0, task.start, jnp.array([1.0, 0.3]))
    assert rate.shape == task.start.shape
    assert jnp.all(jnp.isfinite(rate))
    for t in jnp.linspace(0.0, task.time_limit, 9):
        assert task.clearance(task.objective.target(t)) > 0.2
    if isinstance(task.objective, ReachGoal):
        assert task.objective.distance(task.start[:2]) > 1.0
    else:
        np.testing.assert_array_equal(task.objective.target(0.0), task.start[:2])
    dynamics = task.truth.dynamics
    assert isinstance(dynamics, Swimmer) == (len(task.start) == 4)
    # what trains has the surroundings of the task; propulsion is the scenario's
    world = scenario(tasks.TASKS[name][1]).true_swimmer
    assert eqx.tree_equal(world.environment, dynamics.environment)


def test_training_is_an_observed_scenario():
    data = tasks.training("vortex", jax.random.key(1), count=2)
    assert len(data) == 2
    assert data.provenance["noise"] == 0.02
    assert data.provenance["scenario"] == "vortex-current"


@pytest.mark.parametrize(
    ("name", "thrust"), [("barrier-weak", 0.8), ("barrier-strong", 1.5), ("shear", 1.0)]
)
def test_the_screw_has_the_thrust_that_the_task_tells(name, thrust):
    task = tasks.task(name)
    np.testing.assert_allclose(
        greatest_thrust(task.truth.actuator, task.limits), thrust, rtol=1e-9
    )
    beyond = jnp.array([1.05 * task.limits.max_frequency, 0.0])
    assert jnp.linalg.norm(task.truth.actuator(beyond)) < thrust


def test_the_barrier_pushes_more_than_the_weak_and_less_than_the_strong_thrust():
    barrier = tasks.task("barrier-weak").truth.dynamics.environment
    offsets = jnp.linspace(0.0, 8.0, 801)
    points = jnp.stack([5.0 + offsets, jnp.full_like(offsets, 5.0)], axis=1)
    forces = jax.vmap(lambda x: barrier(0.0, x, x))(points)
    np.testing.assert_allclose(jnp.max(forces), 1.098, rtol=1e-3)


def test_straight_over_the_barrier_needs_the_strong_thrust():
    for name, least, most in (("barrier-weak", 0, 2), ("barrier-strong", 10, 20)):
        task = tasks.task(name)
        straight = StraightLine(task.objective, task.limits)
        arrived = run_many(task, straight, KEYS).reached.sum()
        assert least <= arrived <= most, name


@pytest.mark.parametrize("name", ["follow-line", "follow-circle", "follow-eight"])
def test_paths_can_be_followed_through_the_drift(name):
    """The swimmer is quicker than the path is against the drift."""
    task = tasks.task(name)
    assert isinstance(task.objective, FollowPath)
    ts = jnp.linspace(0.0, task.time_limit, 200)
    path = task.objective.path

    def needed(t):
        velocity = jax.jacfwd(path)(t)
        return jnp.linalg.norm(velocity - task.truth(0.0, path(t), jnp.zeros(2)))

    assert jnp.max(jax.jit(jax.vmap(needed))(ts)) < 0.95


@pytest.mark.parametrize("ask", [tasks.task, lambda n: tasks.training(n, KEYS[0])])
def test_unknown_task_is_refused_with_the_known_ones(ask):
    with pytest.raises(InputError, match="task 'maze' is unknown; choose .*vortex"):
        ask("maze")


def test_physics_alone_has_no_environment():
    task = tasks.task("barrier-weak")
    at = jnp.array([3.0, 4.0, 0.5, -1.0])
    alone = physics_only(task.truth)(0.0, at, jnp.zeros(2))
    np.testing.assert_allclose(alone, [0.5, -1.0, -0.18, 0.36])
    assert eqx.tree_equal(physics_only(task.truth).actuator, task.truth.actuator)
