import jax.numpy as jnp
import numpy as np
import pytest

from pinav.evaluation import exact_forces
from pinav.fitting.environments.force_prior import (
    AS_FINE_AS_FORCES,
    lay_layers,
    layers_root,
)
from pinav.fitting.environments.kernels import num_weights
from pinav.fitting.environments.rates import ForceSamples
from pinav.forces import GaussianBarrier, KernelPotential, LayeredPotential, power_hill

CENTER = np.array([1.0, 2.0])
ANGLES = np.linspace(0.0, 2.0, 4)[:, None, None]
ALONG = np.linspace(-15.0, 15.0, 120)[None, :, None]
LINES = CENTER + ALONG * np.concatenate([np.cos(ANGLES), np.sin(ANGLES)], axis=2)
POSITIONS = LINES.reshape(-1, 2) + [0.1, 0.0]


def samples_of(force):
    return ForceSamples(POSITIONS, POSITIONS, exact_forces(force, POSITIONS))


@pytest.fixture(scope="module")
def layers():
    return lay_layers(samples_of(power_hill(3.0, CENTER, 0.8, 2.0))).layers


def test_layers_are_half_as_wide_each_and_the_finest_where_the_hill_is_steep(layers):
    widths = np.array([layer.width for layer in layers])
    assert len(layers) > 2
    np.testing.assert_allclose(widths[1:], 0.5 * widths[:-1])
    reach = [
        np.linalg.norm(np.asarray(one.centers) - CENTER, axis=1).max() for one in layers
    ]
    assert reach[0] > 14.0
    assert reach[-1] < 4.0


def test_a_smooth_force_needs_few_layers(layers):
    smooth = lay_layers(samples_of(GaussianBarrier(3.0, CENTER, 8.0)))
    assert len(smooth.layers) < len(layers)


def test_a_force_that_no_kernels_explain_ends(layers):
    noise = np.random.default_rng(0).normal(size=POSITIONS.shape)
    noisy = ForceSamples(POSITIONS, POSITIONS, noise)
    for laid in (lay_layers(noisy), LayeredPotential(layers)):
        assert num_weights(laid) <= AS_FINE_AS_FORCES.max_weights


def test_weights_of_a_layer_are_as_large_as_the_forces_ask_for():
    rng = np.random.default_rng(2)
    places = rng.uniform(-2.0, 2.0, size=(200, 2))
    layers = [
        KernelPotential.with_zero_weights(centers, width)
        for centers, width in ((places[:40], 0.8), (places[40:60], 0.3))
    ]
    weights = jnp.asarray(2.0 * rng.normal(size=40))
    truth = KernelPotential(weights, jnp.asarray(places[:40]), 0.8)
    samples = ForceSamples(places, places, exact_forces(truth, places))
    root = layers_root(LayeredPotential(tuple(layers)), samples)
    sizes = root.diagonal()
    np.testing.assert_array_equal(root, np.diag(sizes))
    np.testing.assert_allclose(sizes[:40], sizes[0])
    assert 1.5 < sizes[0] < 2.7
    assert sizes[40:].max() < 0.05
