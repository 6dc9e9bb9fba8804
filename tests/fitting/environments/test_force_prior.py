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
from pinav.forces import GaussianBarrier, KernelForce, KernelPotential

PATH = np.stack(
    [np.linspace(-3.0, 5.0, 80), 0.3 + 0.4 * np.sin(np.linspace(0.0, 3.0, 80))], axis=1
)


def test_the_root_is_that_of_the_smooth_process_and_a_white_part():
    barrier = GaussianBarrier(3.0, [2.0, 0.3], 1.5)
    prior = choose_kernels(KernelPotential, PATH, PATH, exact_forces(barrier, PATH))
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
        forces = exact_forces(barrier, PATH)
        prior = choose_kernels(KernelPotential, PATH, PATH, forces)
        assert prior is not None
        assert prior.suits
        assert prior.missed < NOISE
        assert not AS_FINE_AS_FORCES.is_needed(prior.environment, prior.chosen.shape)
        widths.append(float(prior.environment.kernels.width))
    assert widths[1] < widths[0]


def test_the_force_of_the_mean_is_that_at_the_samples():
    barrier = GaussianBarrier(3.0, [2.0, 0.3], 1.5)
    forces = exact_forces(barrier, PATH)
    prior = choose_kernels(KernelForce, PATH, PATH, forces)
    assert prior is not None
    missed = exact_forces(prior.force, PATH) - forces
    size = np.sqrt(np.mean(forces**2))
    assert np.sqrt(np.mean(missed**2)) == pytest.approx(prior.missed * size)
    columns = force_columns(prior.environment, PATH) @ prior.mean
    np.testing.assert_allclose(columns, (missed + forces).ravel(), atol=1e-9)


@pytest.mark.slow
def test_forces_that_no_grid_explains_have_no_kernels_of_one_width():
    noise = np.random.default_rng(0).normal(size=PATH.shape)
    assert choose_kernels(KernelPotential, PATH, PATH, noise) is None


def test_a_potential_does_not_explain_a_force_that_turns():
    turning = np.stack([-PATH[:, 1], PATH[:, 0]], axis=1)
    both = np.concatenate([PATH, PATH + [0.0, 1.0]])
    forces = np.concatenate([turning, turning + [-1.0, 0.0]])
    kernels = choose_kernels(KernelForce, both, both, forces)
    assert kernels is not None
    laid = kernels.environment.kernels
    potential = KernelPotential.with_zero_weights(
        np.asarray(laid.centers), float(laid.width)
    )
    other = ForcePrior.of(potential, both, forces)
    assert kernels.chosen.log_evidence > other.chosen.log_evidence
