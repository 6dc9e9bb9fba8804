"""Gauss-Newton fits of first-order dynamics: positions are the whole state."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from pinav.dynamics import Adaptive, FixedStep, OverdampedSwimmer
from pinav.fitting import (
    Observations,
    Problem,
    TrajectoryLoss,
    curriculum,
    fit,
)
from pinav.fitting.matching.trainable import split_trainable
from pinav.fitting.matching.windows import Windows
from pinav.forces import (
    GaussianBarrier,
    HarmonicTrap,
    NeuralForce,
    PositionFeatures,
    tanh_network,
)
from pinav.trajectories import Trajectories

pytestmark = pytest.mark.slow

TRUTH = OverdampedSwimmer(
    HarmonicTrap(0.6, [1.0, 0.0]), GaussianBarrier(0.8, [0.1, 0.1], 0.7), 0.9
)


def observe(*lengths) -> Trajectories:
    """Irregular times, with some samples missing and some components of others."""
    rng = np.random.default_rng(3)
    times = [np.cumsum(rng.uniform(0.05, 0.15, length)) for length in lengths]
    starts = [jnp.asarray([-1.5, rng.normal(0.0, 0.5)]) for _ in lengths]
    states = [
        np.asarray(Adaptive().solve(TRUTH, y0, jnp.asarray(ts))[0])
        for y0, ts in zip(starts, times, strict=True)
    ]
    observed = [np.ones((length, 2), bool) for length in lengths]
    for mask in observed:
        mask[5:8] = False
        mask[10, 1:] = False
    return Trajectories.from_arrays(
        times, states, observed=observed, channels=("x", "y")
    )


def network_swimmer() -> OverdampedSwimmer:
    features = PositionFeatures((0.0, 0.0), (1.0, 1.0))
    network = tanh_network(2, 2, width=4, depth=1, key=jax.random.key(0))
    return TRUTH.with_environment(NeuralForce(network, features))


MODELS = {
    "network": (network_swimmer, lambda m: m.environment.parameters),
    "barrier and mobility": (
        lambda: TRUTH,
        lambda m: (m.environment, m.mobility.value),
    ),
}


@pytest.mark.parametrize(
    ("name", "window"), [("network", 4), ("barrier and mobility", 100)]
)
def test_the_jacobian_is_that_of_the_residuals(name, window):
    make, trainable = MODELS[name]
    data = observe(14, 18)
    params, static = split_trainable(make(), trainable, jnp.float64)
    observations = Observations.of(data, jnp.float64)
    problem = Problem(static, observations, TrajectoryLoss(FixedStep()))
    inputs = jnp.asarray(window), FixedStep()
    windows, theta = Windows.of(problem, params, *inputs), ravel_pytree(params)[0]

    @jax.jit
    def both(theta):
        starts, _, _ = windows.surrogate(theta)
        exact = jax.jacrev(lambda theta: windows.surrogate(theta)[1])(theta)
        return windows.jacobian(theta, starts), exact

    ours, exact = both(theta)
    scale = np.abs(exact).max()
    assert scale > 0
    np.testing.assert_allclose(ours, exact, atol=1e-9 * scale, rtol=1e-9)


@pytest.mark.slow
def test_the_default_recipe_finds_barrier_and_mobility():
    """The trap is known, so that mobility and height can be told apart."""
    data = observe(30, 30, 30)
    wrong = OverdampedSwimmer(
        TRUTH.propulsion, GaussianBarrier(0.5, [0.0, 0.2], 0.8), 1.1
    )
    result = fit(
        wrong,
        data,
        curriculum(data),
        trainable=lambda m: (m.environment, m.mobility.value),
        objective=TrajectoryLoss(FixedStep(substeps=2)),
        dtype=jnp.float64,
    )
    found, _ = ravel_pytree((result.model.environment, result.model.mobility))
    true, _ = ravel_pytree((TRUTH.environment, TRUTH.mobility))
    np.testing.assert_allclose(found, true, rtol=1e-5)
