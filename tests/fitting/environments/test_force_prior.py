import jax.numpy as jnp
import numpy as np
import pytest

from pinav.fitting.environments.force_prior import (
    AS_FINE_AS_FORCES,
    NOISE,
    ForcePrior,
    lay_smooth_kernels,
    layers_root,
)
from pinav.forces import GaussianBarrier, KernelForce, KernelPotential, LayeredPotential

PATH = np.stack(
    [np.linspace(-3.0, 5.0, 80), 0.3 + 0.4 * np.sin(np.linspace(0.0, 3.0, 80))], axis=1
)


def forces_of(force, positions):
    zero = jnp.zeros(2)
    return np.array([force(0.0, jnp.asarray(x), zero) for x in positions])


def test_the_root_is_that_of_the_smooth_process_and_a_white_part():
    barrier = GaussianBarrier(3.0, [2.0, 0.3], 1.5)
    prior = lay_smooth_kernels(KernelPotential, PATH, PATH, forces_of(barrier, PATH))
    assert prior is not None
    root, size = prior.root(), prior.chosen.amplitude
    smooth = prior.environment.prior().covariance(prior.chosen.shape)
    whole = size**2 * smooth + prior.white**2 * np.eye(len(smooth))
    np.testing.assert_allclose(root @ root.T, whole, atol=1e-10 * whole.max())
    assert prior.white < 0.01 * size
    lengths = np.linalg.norm(root, axis=0)
    assert np.all(np.diff(lengths) <= 1e-12 * lengths[0])


def test_kernels_are_as_fine_as_the_force_asks_for():
    widths = []
    for scale in (2.0, 0.5):
        barrier = GaussianBarrier(3.0, [2.0, 0.3], scale)
        forces = forces_of(barrier, PATH)
        prior = lay_smooth_kernels(KernelPotential, PATH, PATH, forces)
        assert prior is not None
        assert prior.suits
        assert prior.missed < NOISE
        assert not AS_FINE_AS_FORCES.is_needed(prior.environment, prior.chosen.shape)
        widths.append(float(prior.environment.kernels.width))
    assert widths[1] < widths[0]


@pytest.mark.slow
def test_forces_that_no_grid_explains_have_no_kernels_of_one_width():
    noise = np.random.default_rng(0).normal(size=PATH.shape)
    assert lay_smooth_kernels(KernelPotential, PATH, PATH, noise) is None


def test_a_potential_does_not_explain_a_force_that_turns():
    turning = np.stack([-PATH[:, 1], PATH[:, 0]], axis=1)
    both = np.concatenate([PATH, PATH + [0.0, 1.0]])
    forces = np.concatenate([turning, turning + [-1.0, 0.0]])
    kernels = lay_smooth_kernels(KernelForce, both, both, forces)
    assert kernels is not None
    potential = ForcePrior.of(
        KernelPotential.with_zero_weights(
            np.asarray(kernels.environment.kernels.centers),
            float(kernels.environment.kernels.width),
        ),
        both,
        forces,
    )
    assert kernels.chosen.log_evidence > potential.chosen.log_evidence


def test_weights_of_a_layer_are_as_large_as_the_forces_ask_for():
    rng = np.random.default_rng(2)
    places = rng.uniform(-2.0, 2.0, size=(200, 2))
    layers = [
        KernelPotential.with_zero_weights(centers, width)
        for centers, width in ((places[:40], 0.8), (places[40:60], 0.3))
    ]
    weights = jnp.asarray(2.0 * rng.normal(size=40))
    truth = KernelPotential(weights, jnp.asarray(places[:40]), 0.8)
    root = layers_root(
        LayeredPotential(tuple(layers)), places, forces_of(truth, places)
    )
    sizes = root.diagonal()
    np.testing.assert_array_equal(root, np.diag(sizes))
    np.testing.assert_allclose(sizes[:40], sizes[0])
    assert 1.5 < sizes[0] < 2.7
    assert sizes[40:].max() < 0.05
