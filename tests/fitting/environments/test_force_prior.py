import functools

import numpy as np
import pytest

from pinav.evaluation import exact_forces
from pinav.fitting.environments.force_prior import (
    AS_FINE_AS_FORCES,
    NOISE,
    ForcePrior,
    choose_kernels,
    force_columns,
)
from pinav.fitting.environments.rates import ForceSamples
from pinav.forces import GaussianBarrier, KernelForce, KernelPotential

PATH = np.stack(
    [np.linspace(-3.0, 5.0, 80), 0.3 + 0.4 * np.sin(np.linspace(0.0, 3.0, 80))], axis=1
)


@functools.cache
def laid(kind, scale=1.5):
    """Kernels for the forces of a barrier along the path."""
    forces = exact_forces(GaussianBarrier(3.0, [2.0, 0.3], scale), PATH)
    prior = choose_kernels(kind, ForceSamples(PATH, PATH, forces))
    assert prior is not None
    return prior, forces


every_kind = pytest.mark.parametrize("kind", [KernelPotential, KernelForce])


@every_kind
def test_the_root_is_that_of_the_smooth_process_and_a_white_part(kind):
    prior, _ = laid(kind)
    root, size = prior.root(), prior.chosen.amplitude
    smooth = prior.environment.prior().covariance(prior.chosen.shape)
    whole = size**2 * smooth + prior.white**2 * np.eye(len(smooth))
    np.testing.assert_allclose(root @ root.T, whole, atol=1e-10 * whole.max())
    assert prior.white < 0.01 * size
    lengths = np.linalg.norm(root, axis=0)
    assert np.all(np.diff(lengths) <= 1e-12 * lengths[0])


def test_kernels_are_as_fine_as_the_force_asks_for():
    wide, narrow = (laid(KernelPotential, scale)[0] for scale in (1.5, 0.5))
    for prior in (wide, narrow):
        assert prior.suits
        assert prior.missed < NOISE
        assert not AS_FINE_AS_FORCES.is_needed(prior.environment, prior.chosen.shape)
    assert narrow.environment.kernels.width < wide.environment.kernels.width


@every_kind
def test_the_force_of_the_mean_is_that_at_the_samples(kind):
    prior, forces = laid(kind)
    missed = exact_forces(prior.force, PATH) - forces
    size = np.sqrt(np.mean(forces**2))
    assert np.sqrt(np.mean(missed**2)) == pytest.approx(prior.missed * size)
    columns = force_columns(prior.environment, PATH) @ prior.mean
    np.testing.assert_allclose(columns, (missed + forces).ravel(), atol=1e-9)


@pytest.mark.slow
def test_forces_that_no_grid_explains_have_no_kernels_of_one_width():
    noise = np.random.default_rng(0).normal(size=PATH.shape)
    samples = ForceSamples(PATH, PATH, noise)
    assert choose_kernels(KernelPotential, samples) is None


def test_a_potential_does_not_explain_a_force_that_turns():
    turning = np.stack([-PATH[:, 1], PATH[:, 0]], axis=1)
    both = np.concatenate([PATH, PATH + [0.0, 1.0]])
    forces = np.concatenate([turning, turning + [-1.0, 0.0]])
    samples = ForceSamples(both, both, forces)
    kernels = choose_kernels(KernelForce, samples)
    assert kernels is not None
    laid = kernels.environment.kernels
    potential = KernelPotential.with_zero_weights(
        np.asarray(laid.centers), float(laid.width)
    )
    other = ForcePrior.of(potential, samples)
    assert kernels.chosen.log_evidence > other.chosen.log_evidence
