"""What to record next, as a fit without inertia knows it."""

import jax.numpy as jnp
import numpy as np
import pytest
from tests.navigation.steering_worlds import open_water

from pinav.actuation import LinearResponse, RollingActuator
from pinav.dynamics import OverdampedSwimmer
from pinav.fitting import AbstractLearned, Posterior, ravel_model
from pinav.fitting.environments.summary import ModelChoice
from pinav.forces import KernelPotential, ZeroForce
from pinav.navigation import NavigationProblem, Rectangle, SteeredSwimmer
from pinav.navigation.problem import suggest_trajectory
from pinav.navigation.task.task import ReachGoal
from pinav.systems import System
from pinav.trajectories import Trajectories

ROUTE = np.linspace([0.0, 0.0], [3.0, 1.0], 12)


class Fit(AbstractLearned):
    """A fit of a few kernels to short tracks near the start."""

    model, wandering, constants, horizon = None, None, {}, 1.5
    noise, posterior, evidence = 0.02, None, None

    def __init__(self, swimmer):
        times = 0.1 * np.arange(9)
        tracks = [np.stack([0.2 * times + k, 0.1 * times], 1) for k in range(3)]
        self.data = Trajectories.from_arrays([times] * 3, tracks, channels=("x", "y"))
        self.system, self.choice = (
            System("water", swimmer.without_environment(), 2),
            ModelChoice(),
        )
        self.models = {"model": swimmer}

    def start(self, index):
        raise NotImplementedError

    def shared_trajectories(self, data):
        raise NotImplementedError


def problem_of(mobility):
    """The same motion whatever the mobility, by forces in another unit."""
    places = jnp.array([[0.0, 0.0], [1.5, 0.5], [3.0, 1.0], [1.5, -1.0]])
    weights = jnp.array([0.1, -0.05, 0.02, 0.04]) / mobility
    kernels = KernelPotential(weights, places, 1.0)
    swimmer = OverdampedSwimmer(ZeroForce(), kernels, mobility)
    free, theta = ravel_model(swimmer, lambda m: m.environment.parameters)
    covariance = (0.02 / mobility) ** 2 * np.eye(4)
    actuator = RollingActuator(jnp.eye(2) / mobility, LinearResponse())
    steered = SteeredSwimmer(swimmer, actuator)
    task = open_water(
        truth=steered,
        objective=ReachGoal([3.0, 1.0], 0.3),
        arena=Rectangle([-2.0, -3.0], [5.0, 4.0]),
    )
    posterior = Posterior(free, np.asarray(theta), covariance)
    return NavigationProblem(task, steered, Fit(swimmer), posterior=posterior)


def test_a_suggestion_is_in_the_unit_of_the_fitted_force():
    whole, half = (suggest_trajectory(problem_of(m), ROUTE, seed=0) for m in (1.0, 0.5))
    assert whole.sd_after < whole.sd_after_random < whole.sd
    for name in ("sd", "sd_after", "sd_after_random"):
        assert getattr(half, name) == pytest.approx(2 * getattr(whole, name), rel=1e-5)
    np.testing.assert_allclose(half.path, whole.path, atol=1e-6)
    np.testing.assert_allclose(whole.start, [0.0, 0.0], atol=0.3)
    assert whole.times[-1] == pytest.approx(0.8)
