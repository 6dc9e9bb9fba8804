import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from tests.fitting.structure.observed_forces import observed_forces

from pinav.fitting.environments.kernels import KernelGrid, surround_with_kernels
from pinav.fitting.evidence.evidence import LinearisedObservations, at_shape
from pinav.fitting.rugged.hills import propose_hills
from pinav.fitting.structure.potential_map import free_potential
from pinav.fitting.structure.response import force_quadratic
from pinav.forces import (
    GaussianBarrier,
    KernelPotential,
    LinearForce,
    SumForce,
    gaussian_ridge,
)
from pinav.forces.terms import MIDDLE, WIDTHS

POINTS = np.random.default_rng(1).uniform(0.0, 10.0, (1, 300, 2))
NOISE = 0.02
BARRIERS = (
    GaussianBarrier(3.0, [2.0, 3.0], 0.8),
    GaussianBarrier(-2.0, [7.0, 2.5], 1.1),
    GaussianBarrier(1.5, [5.0, 7.5], 0.9),
)
RIDGE = gaussian_ridge(2.0, [4.0, 4.0], 1.8, 0.6, 0.7)


def hills_of(truth):
    """The hills that are proposed about free kernels whose prior is stationary."""
    response = observed_forces(truth, POINTS, NOISE)
    potential = free_potential(response, POINTS[0])
    prior = potential.prior()
    data = LinearisedObservations.of(force_quadratic([potential], response))
    shape = np.array([0.5, prior.bounds[1, 1], 0.0, 0.0])
    chosen = at_shape(data, prior.covariance, shape, NOISE)
    return propose_hills(response, NOISE, potential, chosen)


@pytest.mark.parametrize("truth", [SumForce(BARRIERS), SumForce((*BARRIERS, RIDGE))])
def test_hills_and_wells_have_the_places_heights_and_sizes_of_the_true_ones(truth):
    term = hills_of(truth)
    heights = np.asarray(term.weights).reshape(-1, len(WIDTHS))[:, MIDDLE]
    assert len(heights) == len(truth.terms)
    for barrier in BARRIERS:
        gaps = np.linalg.norm(
            np.asarray(term.centers) - np.asarray(barrier.center), axis=1
        )
        index = int(np.argmin(gaps))
        assert gaps[index] < 0.05
        np.testing.assert_allclose(heights[index], barrier.height, rtol=0.05)
        np.testing.assert_allclose(
            np.exp(term.shapes[index, 0]), barrier.width, rtol=0.05
        )


def test_a_fibre_is_one_hill_of_its_length_and_width():
    (hill,) = hills_of(RIDGE).shapes
    size, shear = np.exp(hill[0]), np.hypot(*hill[1:])
    np.testing.assert_allclose(size * np.exp(shear), 1.8, rtol=0.05)
    np.testing.assert_allclose(size * np.exp(-shear), 0.6, rtol=0.05)


def test_what_no_hill_is_like_is_left_to_coarse_kernels():
    """A linear force beside two hills moves neither."""
    slope = LinearForce(np.array([[0.1, 0.05], [0.05, -0.1]]), [5.0, 5.0])
    term = hills_of(SumForce((*BARRIERS[:1], slope)))
    gaps = np.linalg.norm(
        np.asarray(term.centers) - np.asarray(BARRIERS[0].center), axis=1
    )
    assert gaps.min() < 0.1


def test_no_hills_are_proposed_whose_fit_fails(monkeypatch):
    def fail(*_, **__):
        raise ValueError("Residuals are not finite in the initial point.")

    monkeypatch.setattr(scipy.optimize, "least_squares", fail)
    assert hills_of(SumForce(BARRIERS)) is None


@pytest.mark.parametrize(
    "across",
    [
        pytest.param(20, id="many summits"),
        pytest.param(8, id="few summits", marks=pytest.mark.slow),
    ],
)
def test_a_field_that_is_rough_everywhere_has_no_hills(across):
    centers, width = surround_with_kernels(POINTS[0], KernelGrid(across=across))
    weights = jnp.asarray(np.random.default_rng(3).normal(size=len(centers)))
    assert hills_of(KernelPotential(weights, jnp.asarray(centers), width)) is None
