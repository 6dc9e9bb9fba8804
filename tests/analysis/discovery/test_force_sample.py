import numpy as np
import pytest

from pinav.analysis.discovery.force_sample import (
    Centrality,
    ForceSample,
    central_test,
    spread_points,
)
from pinav.analysis.discovery.law_regression import fit_law, fit_sum, law_force, screen
from pinav.errors import InputError
from pinav.forces.geometries import Center, Ellipse
from pinav.forces.law_library import (
    CHANNEL,
    CONSTANT_FORCE,
    GAUSSIAN,
    GAUSSIAN_SWIRL,
    HARMONIC,
    LATTICES,
    PLANE_WAVE,
    RING,
    WALL,
)
from pinav.forces.laws import ProfileLaw
from pinav.forces.profiles import CompactHill, Gaussian, Lorentzian

POSITIONS = np.random.default_rng(0).uniform(0.0, 8.0, (60, 2))
BARRIER = np.array([5.25, 5.0, 4.0, 2.9])


def sample_of(force, sd=1e-3, noise=0.0):
    covariance = sd**2 * np.eye(force.size)
    return ForceSample(POSITIONS, force + noise, covariance, 40.0)


CASES = {
    GAUSSIAN: BARRIER,
    HARMONIC: [0.8, 3.0, 5.0],
    ProfileLaw(Lorentzian(), Center()): [-3.0, 4.0, 4.5, 1.5],
    ProfileLaw(CompactHill(), Center()): [3.0, 4.0, 4.5, 3.5, 3.0],
    RING: [2.0, 4.0, 4.5, 2.5, 0.8],
    ProfileLaw(Gaussian(), Ellipse()): [4.0, 5.0, 4.0, 0.4, 0.4, 1.9],
    WALL: [3.0, 0.4, 4.5, 0.8],
    CHANNEL: [3.0, 0.4, 4.5, 2.5, 0.8],
    PLANE_WAVE: [0.7, -0.4, 1.5, 0.6],
    LATTICES[0]: [0.7, -0.4, 0.2, 0.6, 1.5, 0.6, -0.6, 1.5],
    GAUSSIAN_SWIRL: [2.0, 4.0, 5.0, 2.0],
}


@pytest.mark.parametrize("law", CASES, ids=lambda law: law.name)
def test_exact_forces_give_back_their_law(law):
    constants = np.array(CASES[law])
    force = law_force(law, constants, POSITIONS)
    fitted = fit_law(law, sample_of(force))
    again = law_force(law, fitted.constants, POSITIONS)
    np.testing.assert_allclose(again, force, atol=1e-5)
    if law is GAUSSIAN:
        np.testing.assert_allclose(fitted.constants, constants, rtol=1e-6)


def test_sum_is_found_from_what_the_first_term_leaves():
    swirl = np.array([1.6, 4.5, 4.0, 2.0])
    force = law_force(
        GAUSSIAN + GAUSSIAN_SWIRL, np.concatenate([BARRIER, swirl]), POSITIONS
    )
    sample = sample_of(force)
    alone = fit_law(GAUSSIAN, sample)
    both = fit_sum(alone, GAUSSIAN_SWIRL, sample)
    assert both.squares < 1e-6 * alone.squares
    np.testing.assert_allclose(both.constants[4], 1.6, rtol=1e-4)


def test_two_gaussians_are_told_apart():
    pair = np.array([4.0, 2.0, 2.5, 1.2, 3.0, 6.0, 5.5, 1.4])
    sample = sample_of(law_force(GAUSSIAN + GAUSSIAN, pair, POSITIONS))
    best = screen(sample, (GAUSSIAN, HARMONIC, CONSTANT_FORCE))[0]
    assert best.law == GAUSSIAN + GAUSSIAN
    halves = sorted((best.constants[:4], best.constants[4:]), key=lambda c: c[1])
    np.testing.assert_allclose(np.concatenate(halves), pair, rtol=1e-4)


def test_errors_that_are_shared_count_once():
    """A shared offset, known to be uncertain, must not move the fit."""
    force = law_force(GAUSSIAN, BARRIER, POSITIONS)
    offset = np.tile([1.0, 0.0], len(POSITIONS))
    covariance = 4.0 * np.outer(offset, offset) + 1e-8 * np.eye(len(offset))
    shifted = ForceSample(POSITIONS, force + [0.5, 0.0], covariance, 40.0)
    naive = sample_of(force + np.array([0.5, 0.0]))
    right = fit_law(GAUSSIAN, shifted).constants
    wrong = fit_law(GAUSSIAN, naive).constants
    assert np.abs(right - BARRIER).max() < 0.05 * np.abs(wrong - BARRIER).max()


def test_central_force_has_a_centre():
    force = law_force(GAUSSIAN, BARRIER, POSITIONS)
    noise = np.random.default_rng(1).normal(0.0, 0.03, force.shape)
    found = central_test(sample_of(force, 0.03, noise))
    assert found.verdict is Centrality.CENTRAL
    offset = np.array(found.center) - BARRIER[1:3]
    assert np.all(np.abs(offset) < 3.5 * np.array(found.center_sd))
    exact = central_test(sample_of(force, 1e-9))
    np.testing.assert_allclose(exact.center, BARRIER[1:3], atol=1e-8)
    assert exact.ratio < 1e-8


def test_swirl_is_not_central():
    force = law_force(GAUSSIAN, BARRIER, POSITIONS)
    force = force + law_force(GAUSSIAN_SWIRL, np.array([0.8, 5.0, 4.0, 2.0]), POSITIONS)
    found = central_test(sample_of(force, 0.01))
    assert found.verdict is Centrality.NOT_CENTRAL
    assert found.ratio > 10 * found.noise_ratio


@pytest.mark.parametrize(
    ("law", "constants", "seed"),
    [(GAUSSIAN, [0.0525, *BARRIER[1:]], 2), (CONSTANT_FORCE, [1.0, 0.5], 4)],
    ids=["noise hides it", "it has no centre"],
)
def test_whether_a_force_is_central_may_not_be_told(law, constants, seed):
    force = law_force(law, np.array(constants), POSITIONS)
    noise = np.random.default_rng(seed).normal(0.0, 0.05, force.shape)
    found = central_test(sample_of(force, 0.05, noise))
    assert np.all(np.isfinite(found.center))
    assert found.verdict is Centrality.UNDECIDED


@pytest.mark.slow
def test_p_value_is_uniform_for_central_forces():
    force = law_force(GAUSSIAN, BARRIER, POSITIONS)
    generator = np.random.default_rng(3)
    noises = generator.normal(0.0, 0.3, (60, *force.shape))
    tests = [central_test(sample_of(force, 0.3, noise)) for noise in noises]
    assert 0 < np.mean([test.p_value < 0.1 for test in tests]) < 0.25


def test_spread_points_are_far_apart_and_distinct():
    line = np.stack([np.linspace(0.0, 1.0, 101), np.zeros(101)], axis=1)
    chosen = spread_points(line, 5)
    np.testing.assert_allclose(np.sort(line[chosen, 0]), [0, 0.25, 0.5, 0.75, 1.0])
    assert len(spread_points(np.repeat(line[:3], 4, axis=0), 10)) == 3


def test_sample_of_wrong_shape_is_refused():
    with pytest.raises(InputError, match="four or more planar positions"):
        ForceSample(POSITIONS, np.zeros((60, 2)), np.eye(60), 1.0)
