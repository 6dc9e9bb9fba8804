"""Networks in `fit_bayes`: how they are made, taught and fitted."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.fitted_runs import crossing_system, crossings
from tests.fitting.problems import beginning

from pinav.analysis import influence
from pinav.dynamics import FixedStep
from pinav.errors import InputError
from pinav.evaluation import exact_forces, rollout_bands
from pinav.fitting import (
    Outcome,
    fit_bayes,
    kernel_environment,
    model_evidence,
    neural_environment,
)
from pinav.fitting.bayes.distillation import OF_STRUCTURE, distil, distillation_targets
from pinav.fitting.bayes.neural import FitSpecification, function_prior
from pinav.forces import (
    AbstractForce,
    KernelPotential,
    NeuralForce,
    NeuralPotential,
    PositionTimeFeatures,
    spread_weights,
    tanh_network,
)
from pinav.trajectories import Trajectories

pytestmark = pytest.mark.slow

NOISE = 0.02


def damping_of(model):
    return model.drag.damping


KINDS = [NeuralForce, NeuralPotential]


@pytest.fixture(scope="module")
def scenario():
    """Three of the crossings, for their first five time units."""
    return crossing_system(3, 51)


@pytest.fixture(scope="module")
def data():
    return crossings(51, count=3, key=1)


def small(kind, data, **options):
    return neural_environment(
        kind, data, key=jax.random.key(0), width=12, depth=2, **options
    )


def relative(found, true):
    return np.linalg.norm(found - true) / np.linalg.norm(true)


@pytest.mark.parametrize(("kind", "factor"), [(NeuralForce, 7), (NeuralPotential, 49)])
def test_inputs_are_standardised_and_forces_of_the_unit_of_the_data(data, kind, factor):
    made = small(kind, data)
    points = jnp.asarray(data.states[..., :2].reshape(-1, 2))
    inputs = jax.vmap(lambda x: made.features(0.0, x, x))(points)
    np.testing.assert_allclose(inputs.mean(axis=0), 0.0, atol=0.02)
    np.testing.assert_allclose((inputs**2).mean(), 1.0, atol=0.05)
    larger = Trajectories.from_arrays(
        list(data.times), list(7.0 * data.states), channels=data.channels
    )
    assert small(kind, larger).scale == pytest.approx(factor * made.scale)


def test_the_speed_is_the_unit_of_force_without_inertia():
    steady, still = (
        Trajectories.from_arrays(np.arange(5.0), path, channels=("x", "y"))
        for path in (3.0 * np.arange(10.0).reshape(5, 2), np.ones((5, 2)))
    )
    made = small(NeuralForce, steady, dim=2)
    assert made.scale == pytest.approx(np.sqrt(72.0))
    with pytest.raises(InputError, match="neural_environment: expected positions that"):
        small(NeuralForce, still, dim=2)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("options", "most"), [({}, 0.01), ({"how": OF_STRUCTURE}, 0.003)], ids=["", "close"]
)
def test_a_network_learns_what_it_is_taught(scenario, data, kind, options, most):
    barrier, samples = scenario.environment, data.states[..., :2].reshape(-1, 2)
    taught = distillation_targets(
        barrier, data, data.states, dim=2, width=0.5, **options
    )
    np.testing.assert_array_equal(taught.positions[: len(samples)], samples)
    np.testing.assert_allclose(
        taught.forces[: len(samples)], exact_forces(barrier, samples), rtol=1e-12
    )
    network = distil(small(kind, data), taught, *options.values())
    learned = exact_forces(network, np.asarray(taught.positions))
    assert relative(learned, taught.forces) < most


class Swinging(AbstractForce):
    """A force along x that swings in time, the same everywhere."""

    def __call__(self, t, x, v):
        return jnp.cos(t) * jnp.array([1.0, 0.0])


def network_in_time(width):
    features = PositionTimeFeatures((5.0, 5.0, 2.5), (3.0, 3.0, 1.5))
    network = tanh_network(3, 2, width=width, depth=1, key=jax.random.key(0))
    return NeuralForce(spread_weights(network), features)


def test_a_network_that_sees_the_time_learns_a_force_that_swings(data):
    taught = distillation_targets(Swinging(), data, data.states, dim=2, width=0.5)
    found = distil(network_in_time(8), taught)
    points = data.states[0, :5, :2]
    for time in (0.0, 2.0, 4.0):
        expected, own = (
            exact_forces(force, points, np.full(5, time))
            for force in (Swinging(), found)
        )
        np.testing.assert_allclose(own, expected, atol=0.05)


@pytest.fixture(scope="module")
def fitted(scenario, data):
    model = eqx.tree_at(
        lambda m: (m.environment, m.drag.damping),
        scenario.truth,
        (small(NeuralPotential, data), 0.3),
    )
    return fit_bayes(model, data, learn=damping_of)


@pytest.fixture(scope="module")
def errors(fitted, scenario, data):
    """Errors of the force at the samples, their deviation, and the true force."""
    points = data.states[..., :2].reshape(-1, 2)
    true = exact_forces(scenario.environment, points)
    miss = exact_forces(fitted.model.environment, points) - true
    return miss, fitted.posterior.force_sd(points), true


def test_a_network_learns_the_force_from_noisy_crossings(fitted, errors):
    assert fitted.outcome is Outcome.CONVERGED
    assert fitted.iterations <= 10
    assert fitted.hyperparameters.noise == pytest.approx(NOISE, rel=0.1)
    miss, sd, true = errors
    assert np.linalg.norm(miss) < 0.08 * np.linalg.norm(true)
    assert np.mean(np.abs(miss) < 1.96 * sd) > 0.85
    assert isinstance(fitted.model.environment, NeuralPotential)


def test_a_constant_is_learned_beside_a_network(fitted):
    assert list(fitted.constants) == ["drag.damping"]
    damping = fitted.constants["drag.damping"]
    assert abs(damping.value - 0.36) < 3.0 * damping.sd
    assert damping.sd < 0.05


def test_networks_drawn_from_the_posterior_spread_about_it(fitted, data):
    models = fitted.posterior.samples(5, key=jax.random.key(0))
    point = np.array([[5.0, 5.0]])
    draws = np.stack([exact_forces(model.environment, point) for model in models])
    assert np.all(np.isfinite(draws))
    assert np.all(draws.std(axis=0) > 0)
    bands = rollout_bands(fitted.posterior, beginning(data, 11))
    assert np.all(np.isfinite(bands.sd))


def test_the_bands_of_a_network_are_as_wide_as_its_errors(errors):
    """A prior of one variance for all weights makes them five times too wide."""
    miss, sd, _ = errors
    assert 0.4 < np.sqrt(np.mean((miss / sd) ** 2)) < 2.0


def test_the_prior_is_made_again_from_what_a_run_keeps(fitted, data):
    used = fitted.linear.weights
    request = FitSpecification(fitted.model, data, damping_of, None, FixedStep())
    again = function_prior(
        request, fitted.states, fitted.hyperparameters, used.process.kernels
    )
    before = used.process.directions  # at the states from which the fit began
    np.testing.assert_allclose(
        again.process.directions, before, atol=0.01 * np.abs(before).max()
    )
    ratio = np.median(again.misfit / used.misfit)
    assert 0.2 < ratio < 5.0
    left_out = influence(
        fitted.model,
        data,
        fitted.states,
        fitted.hyperparameters,
        learn=damping_of,
        constants={"damping": damping_of},
        kernels=used.process.kernels,
    )
    assert np.all(np.isfinite(left_out.removals))


def test_a_taught_network_costs_what_its_prior_cost_its_teacher(fitted, scenario, data):
    kernels = kernel_environment(KernelPotential, data)
    model = eqx.tree_at(
        lambda m: (m.environment, m.drag.damping), scenario.truth, (kernels, 0.3)
    )
    taught = fit_bayes(model, data, learn=damping_of)
    theirs, ours = (
        model_evidence(found.linear, found.hyperparameters)
        for found in (taught, fitted)
    )
    assert ours.correction == pytest.approx(theirs.correction, rel=1e-3)
    assert ours.correction > 1
    gap = theirs.log_evidence - ours.log_evidence  # what so small a network misses
    assert -5 < gap < 100


def test_a_network_that_sees_the_time_has_independent_weights(scenario, data):
    model = scenario.truth.with_environment(network_in_time(6))
    found = fit_bayes(model, data, max_iterations=1, throw=False)
    assert found.hyperparameters.shape.size == 0
    assert found.hyperparameters.amplitude > 0
