import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.fitted_runs import crossing_system

from pinav import evaluation
from pinav.fitting import Posterior, ravel_model
from pinav.systems import Observation
from pinav.trajectories import Trajectories, simulate

SD = 1e-3
"""Of the barrier's height, in the posterior of these tests."""


def test_normal_errors_are_covered_as_often_as_nominal():
    random = np.random.default_rng(0)
    sd = random.uniform(0.5, 2.0, (4, 5000))
    inside = evaluation.inside_band(sd * random.standard_normal(sd.shape), sd)
    every = np.ones(sd.shape, bool)
    assert evaluation.fraction_inside(inside, every) == pytest.approx(0.95, abs=0.01)
    narrow = evaluation.inside_band(2 * sd * random.standard_normal(sd.shape), sd)
    assert evaluation.fraction_inside(narrow, every) == pytest.approx(0.673, abs=0.02)
    assert np.isnan(evaluation.fraction_inside(inside, np.zeros(sd.shape, bool)))
    errors, sd = np.array([0.1, np.nan, 0.1, np.inf]), np.array([1.0, 1, np.nan, 1])
    assert evaluation.inside_band(errors, sd).tolist() == [True, False, False, False]


def test_coverage_is_told_by_region():
    true = evaluation.FieldMap(
        np.zeros(2), np.zeros(1), np.zeros((1, 2, 2)), np.zeros((1, 2))
    )
    learned = evaluation.FieldMap(
        true.x, true.y, np.array([[[1.0, 9], [9, 9]]]), true.distance
    )
    masks = {"left": np.array([[True, False]]), "right": np.array([[False, True]])}
    found = evaluation.force_coverage(learned, true, np.ones((1, 2, 2)), masks)
    assert found == {"left": 0.5, "right": 0.0}
    data = Trajectories.from_arrays(
        [0.0, 1.0], np.array([[0.0, 0.0], [3.0, 3.0]]), channels=("x", "y")
    )
    bands = evaluation.Bands(np.zeros((1, 2, 2)), np.full((1, 2, 2), 1.2))
    masks = {"all": np.ones((1, 2), bool), "late": np.array([[False, True]])}
    found = evaluation.rollout_coverage(bands, data, 0.5, masks)
    assert found == {"all": 0.5, "late": 0.0}
    assert evaluation.rollout_coverage(bands, data, 1.0, masks)["late"] == 1.0


@pytest.fixture(scope="module")
def shots():
    """Two crossings, and a posterior of the barrier's height alone."""
    scenario = crossing_system(2, 41, observation=Observation())
    height = jnp.asarray(5.25)
    scenario = eqx.tree_at(lambda s: s.environment.height, scenario, height)
    free, theta = ravel_model(scenario.true_swimmer, lambda m: m.environment.height)
    posterior = Posterior(free, np.asarray(theta), np.array([[SD**2]]))
    return scenario, simulate(scenario), posterior


def raised_barrier(scenario):
    return eqx.tree_at(
        lambda m: m.environment.height,
        scenario.true_swimmer,
        scenario.environment.height + SD,
    )


def test_a_band_from_an_exact_start_is_the_effect_of_the_parameters(shots):
    scenario, data, posterior = shots
    bands = evaluation.rollout_bands(posterior, data)
    raised = scenario.with_truth(raised_barrier(scenario).environment)
    moved = simulate(raised).states
    assert_allclose(bands.sd, np.abs(moved - data.states), atol=1e-5, rtol=0.02)
    assert evaluation.rollout_coverage(
        bands, data, 1e-6, {"all": np.ones((2, 41), bool)}
    ) == {"all": 1.0}


def test_an_estimated_start_follows_the_parameters(shots):
    """Finite difference of the whole: another height, its start fitted anew."""
    scenario, data, posterior = shots
    starts = evaluation.estimate_starts(scenario.truth, data)
    bands = evaluation.rollout_bands(posterior, data, starts, noise=0.0)
    raised = raised_barrier(scenario)
    refitted = evaluation.estimate_starts(raised, data)
    moved = np.abs(refitted.lifted - starts.lifted)
    assert_allclose(bands.sd[:, :20], moved, atol=2e-6, rtol=0.05)


def test_noise_of_the_first_samples_widens_the_band(shots):
    scenario, data, posterior = shots
    sure = Posterior(posterior.free, posterior.mean, np.zeros((1, 1)))
    noise = 0.01
    starts = evaluation.estimate_starts(scenario.truth, data)
    bands = evaluation.rollout_bands(sure, data, starts, noise=noise)
    errors = []
    for seed in range(60):
        random = np.random.default_rng(seed)
        noisy = eqx.tree_at(
            lambda t: t.states,
            data,
            data.states + noise * random.standard_normal(data.states.shape),
        )
        errors.append(
            evaluation.estimate_starts(scenario.truth, noisy).states - starts.states
        )
    measured = np.std(errors, axis=0)
    assert_allclose(bands.sd[:, 0], measured, rtol=0.35)
    assert jnp.all(bands.observable_sd(noise) > bands.sd)
    assert isinstance(jax.tree.leaves(bands)[0], np.ndarray)


def test_a_recovered_constant_has_a_z_score():
    found = evaluation.ParameterRecovery("damping", true=0.36, value=0.35, sd=0.005)
    assert found.z == pytest.approx(-2.0)
    assert found.relative_error == pytest.approx(-0.01 / 0.36)
    assert evaluation.ParameterRecovery("gain", 0.0, 0.1, None).z is None
    assert np.isnan(evaluation.ParameterRecovery("gain", 0.0, 0.1, None).relative_error)
