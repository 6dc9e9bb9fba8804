"""Residuals by position, and least squares."""

import jax.numpy as jnp
import numpy as np
import pytest

from pinav import identification
from pinav.fitting import KernelGrid, kernel_environment
from pinav.forces import KernelForce
from pinav.identification.residual_field import positions_of, residual_errors
from pinav.trajectories import Trajectories

SEED = 4


def vortex(duration=120.0):
    """A passive particle that a rotation and a trap about (3, 0) carry, and noise."""
    random = np.random.default_rng(SEED)
    path, x = [], np.array([9.0, 0.0])
    for kick in random.normal(size=(int(duration / 0.1), 2)):
        offset = x - np.array([3.0, 0.0])
        turned = np.array([-offset[1], offset[0]])
        x = x + 0.1 * (0.5 * turned - 0.05 * offset) + 0.12 * kick
        path.append(x)
    times = 0.1 * np.arange(len(path))
    seen = np.array(path) + 0.02 * random.normal(size=(len(path), 2))
    return Trajectories.from_arrays([times], [seen], channels=("x", "y"))


@pytest.fixture(scope="module")
def passive():
    return identification.tracks(vortex(), pooled=True)[0]


@pytest.fixture(scope="module")
def drifting(passive):
    return identification.fit_track(passive, identification.drift_only())


@pytest.mark.slow
def test_a_kernel_residual_finds_a_field_that_is_there(passive, drifting):
    grid = KernelGrid(across=5, margin=2.0)
    environment = kernel_environment(KernelForce, positions_of(passive), grid, dim=2)
    found = identification.fit_residual(
        passive, identification.drift_only(), drifting, environment
    )
    assert found.log_evidence > drifting.hyperparameters.log_evidence + 5
    place = jnp.array([6.0, 0.0])
    swimmer = found.swimmer
    velocity = swimmer.environment(0.0, place, jnp.zeros(2)) + swimmer.flow.velocity
    np.testing.assert_allclose(velocity, [-0.15, 1.5], atol=0.5)
    rollouts = identification.Rollouts.of(passive, 5.0)
    plain = identification.errors(passive, rollouts, lambda piece: 0 * piece.states)
    assert residual_errors(passive, rollouts, found).median < 0.6 * plain.median


@pytest.mark.slow
def test_least_squares_returns_gain_and_drift(recording, synthetic):
    track = identification.tracks(recording)[0]
    found = identification.least_squares(track)
    rollouts = identification.Rollouts.of(track, 10.0)
    assert identification.errors(track, rollouts, found).relative < 0.2
