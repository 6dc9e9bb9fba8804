import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.fitting.environments.force_regression import lay_layers
from pinav.fitting.environments.kernels import MOST_MATCHED
from pinav.forces import GaussianBarrier, PowerHill

CENTER = np.array([1.0, 2.0])
ANGLES = np.linspace(0.0, 2.0, 4)[:, None, None]
ALONG = np.linspace(-15.0, 15.0, 120)[None, :, None]
LINES = CENTER + ALONG * np.concatenate([np.cos(ANGLES), np.sin(ANGLES)], axis=2)
POSITIONS = LINES.reshape(-1, 2) + [0.1, 0.0]


def forces_of(hill):
    at = jax.vmap(lambda x: hill(0.0, x, jnp.zeros(2)))
    return np.asarray(at(jnp.asarray(POSITIONS)))


@pytest.fixture(scope="module")
def layers():
    return lay_layers(POSITIONS, forces_of(PowerHill(3.0, CENTER, 0.8, 2.0)))


def test_each_layer_is_half_as_wide_as_the_one_before(layers):
    widths = np.array([width for _, width in layers])
    assert len(layers) > 2
    np.testing.assert_allclose(widths[1:], 0.5 * widths[:-1])
    assert sum(len(centers) for centers, _ in layers) <= MOST_MATCHED


def test_the_finest_kernels_are_where_a_long_tailed_hill_is_steep(layers):
    reach = [np.linalg.norm(c - CENTER, axis=1).max() for c, _ in layers]
    assert reach[0] > 14.0
    assert reach[-1] < 4.0


def test_a_smooth_force_needs_few_layers(layers):
    smooth = lay_layers(POSITIONS, forces_of(GaussianBarrier(3.0, CENTER, 8.0)))
    assert len(smooth) < len(layers)


def test_a_force_that_no_kernels_explain_ends():
    noise = np.random.default_rng(0).normal(size=POSITIONS.shape)
    finest = lay_layers(POSITIONS, noise)
    assert sum(len(centers) for centers, _ in finest) <= MOST_MATCHED
