"""The independent optimum: CasADi and IPOPT against closed forms and our physics."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import root_scalar
from tests.navigation.steering_worlds import DRAG, open_water, without_noise

from pinav.dynamics import RK4, FixedStep
from pinav.errors import FitError, InputError
from pinav.forces import GaussianBarrier
from pinav.navigation.control.controller import StraightLine
from pinav.navigation.task import catalogue as tasks
from pinav.navigation.task.task import ReachGoal
from pinav.navigation.trials.closed_loop import run
from validation import minimum_time

needs_casadi = pytest.mark.extras("casadi")


@needs_casadi
def test_without_a_barrier_the_optimum_is_full_thrust_ahead():
    flat = GaussianBarrier(0.0, [1.0, 1.0], 1.0)
    goal = ReachGoal([2.0, 1.0], 0.25)
    task = open_water(inert=True, environment=flat, objective=goal, time_limit=9.0)
    found = minimum_time.minimum_time(task, intervals=20)
    way = 5**0.5 - 0.25

    def left(t):
        return (t - (1 - np.exp(-DRAG * t)) / DRAG) / DRAG - way

    expected = root_scalar(left, bracket=(0.1, 9.0)).root
    np.testing.assert_allclose(found.time, expected, rtol=1e-5)


@needs_casadi
def test_the_strong_thrust_crosses_the_barrier_as_quickly_as_can_be():
    """Its thrusts do so in our physics, too; no straight run is quicker."""
    task = without_noise(tasks.task("barrier-strong"))
    found = minimum_time.minimum_time(task)
    np.testing.assert_allclose(found.time, 7.278, rtol=1e-3)
    step = found.time / len(found.thrusts)

    def move(y, thrust):
        still = eqx.tree_at(lambda s: s.actuator.gain, task.truth, 0.0)
        held = still.under(jnp.zeros(2))
        held = eqx.tree_at(lambda s: s.propulsion.thrust, held, thrust)
        return FixedStep(RK4, 4).step(held, y, 0.0, step), None

    end, _ = jax.lax.scan(move, task.start, jnp.asarray(found.thrusts))
    assert abs(float(task.objective.distance(end[:2]))) < 1e-3
    straight = run(
        task, StraightLine(task.objective, task.limits), key=jax.random.key(0)
    )
    assert straight.arrival_time > 0.998 * found.time


@pytest.mark.parametrize("name", ["vortex", "rotating-barrier", "y-junction"])
def test_other_tasks_are_refused(name):
    with pytest.raises(InputError, match=r"minimum_time: (task .* no inertia|expec)"):
        minimum_time.minimum_time(tasks.task(name))


def test_without_casadi_it_says_how_to_install_it(monkeypatch):
    monkeypatch.setattr(minimum_time.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(FitError, match="CasADi is not installed; pip install"):
        minimum_time.minimum_time(tasks.task("barrier-weak"))


@needs_casadi
def test_too_little_time_is_said():
    task = dataclasses.replace(tasks.task("barrier-weak"), time_limit=2.0)
    with pytest.raises(FitError, match="IPOPT found no way for task 'barrier-weak'"):
        minimum_time.minimum_time(task, intervals=5)
