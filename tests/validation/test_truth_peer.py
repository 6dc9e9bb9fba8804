"""StochasticForceInference is asked for the right quantities, where it is installed."""

import jax
import numpy as np
import pytest
from validation.truth.peer import infer_ring, infer_wall

pytestmark = pytest.mark.extras

HEAT, DIFFUSION = 0.004, 0.1
"""Thermal energy [pN um], and diffusion normal to the wall [um²/s]."""


@pytest.fixture(autouse=True, scope="module")
def standard_promotion():
    """The peer joins arrays of two precisions, which strict promotion forbids."""
    with jax.numpy_dtype_promotion("standard"):
        yield


def test_the_drift_and_diffusion_of_a_ring_are_found():
    rng, step, frames = np.random.default_rng(0), 0.01, 20_000
    angles = np.zeros((frames, 4))
    for k in range(1, frames):
        drift = 1.0 + 0.5 * np.sin(angles[k - 1])
        noise = np.sqrt(2 * DIFFUSION * step) * rng.normal(size=4)
        angles[k] = angles[k - 1] + drift * step + noise
    places = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    said = infer_ring(step * np.arange(frames), angles, 2 * np.pi, places)
    np.testing.assert_allclose(said.diffusion, DIFFUSION, rtol=0.03)
    np.testing.assert_allclose(said.drift.mean(), 1.0, atol=0.05)
    np.testing.assert_allclose(said.drift - 1, 0.5 * np.sin(places), atol=0.15)


def test_force_and_diffusions_above_a_wall_are_found():
    """A trap normal to the wall, and twice the diffusion along it."""
    rng, step, frames, stiffness = np.random.default_rng(1), 0.02, 40_000, 0.02
    positions = np.zeros((frames, 3))
    scale = np.sqrt(2 * DIFFUSION * step * np.array([2.0, 2.0, 1.0]))
    for k in range(1, frames):
        pull = -DIFFUSION / HEAT * stiffness * positions[k - 1, 2] * step
        positions[k] = positions[k - 1] + scale * rng.normal(size=3)
        positions[k, 2] += pull
    heights = positions[:, 2] - positions[:, 2].min()
    positions[:, 2] = heights
    middle = heights.mean()
    places = np.quantile(heights, np.linspace(0.1, 0.9, 9))
    times = step * np.arange(frames)
    said = infer_wall(times, positions, places, HEAT, 0.3)
    np.testing.assert_allclose(said.along, 2 * DIFFUSION, rtol=0.05)
    np.testing.assert_allclose(said.across, DIFFUSION, rtol=0.05)
    slope = np.polyfit(places - middle, said.force, 1)[0]
    np.testing.assert_allclose(slope, -stiffness, rtol=0.25)
