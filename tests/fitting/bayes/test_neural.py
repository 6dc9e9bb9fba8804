"""Networks in `fit_bayes`: how they are made, taught and fitted."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.analysis import influence
from pinav.dynamics import FixedStep
from pinav.errors import InputError
from pinav.fitting import (
    Outcome,
    fit_bayes,
    kernel_environment,
    model_evidence,
    neural_environment,
)
from pinav.fitting.bayes.distillation import (
    OF_STRUCTURE,
    distil,
    distillation_targets,
)
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
from pinav.scenarios import barrier_crossings
from pinav.trajectories import Trajectories, simulate

pytestmark = pytest.mark.slow

NOISE = 0.02


def damping_of(model):
    return model.drag.damping


KINDS = [NeuralForce, NeuralPotential]


@pytest.fixture(scope="module")
def scenario():
    """Three of the crossings, for their first five time units."""
    return eqx.tree_at(
        lambda s: (s.starts, s.times),
        barrier_crossings(),
        replace_fn=lambda a: a[:3] if a.ndim == 2 else a[:51],
    )


@pytest.fixture(scope="module")
def data(scenario):
    return simulate(scenario, key=jax.random.key(1))


def small(kind, data, **options):
    return neural_environment(
        kind, data, key=jax.random.key(0), width=12, depth=2, **options
    )


def forces(force, points, time=0.0):
    return np.asarray(
        jax.vmap(lambda x: force(time, x, jnp.zeros_like(x)))(jnp.asarray(points))
    )


def relative(found, true):
    return np.linalg.norm(found - true) / np.linalg.norm(true)


@pytest.mark.parametrize("kind", KINDS)
def test_inputs_are_standardised_and_forces_of_the_unit_of_the_data(data, kind):
    made = small(kind, data)
    points = jnp.asarray(data.states[..., :2].reshape(-1, 2))
    inputs = jax.vmap(lambda x: made.features(0.0, x, x))(points)
    np.testing.assert_allclose(inputs.mean(axis=0), 0.0, atol=0.02)
    np.testing.assert_allclose((inputs**2).mean(), 1.0, atol=0.05)
    larger = Trajectories.from_arrays(
        list(data.times), list(7.0 * data.states), channels=data.channels
    )
    factor = 7.0 if kind is NeuralForce else 49.0
    assert small(kind, larger).scale == pytest.approx(factor * made.scale)


def test_the_speed_is_the_unit_of_force_without_inertia(data):
    steady = Trajectories.from_arrays(
        np.arange(5.0), 3.0 * np.arange(10.0).reshape(5, 2), channels=("x", "y")
    )
    made = small(NeuralForce, steady, dim=2)
    assert made.scale == pytest.approx(np.sqrt(72.0))
    still = Trajectories.from_arrays(
        np.arange(5.0), np.ones((5, 2)), channels=("x", "y")
    )
    with pytest.raises(InputError, match="neural_environment: expected positions that"):
        small(NeuralForce, still, dim=2)


@pytest.mark.parametrize("kind", KINDS)
def test_a_network_learns_what_it_is_taught(scenario, data, kind):
    barrier = scenario.environment
    taught = distillation_targets(barrier, data, data.states, dim=2, width=0.5)
    samples = data.states[..., :2].reshape(-1, 2)
    np.testing.assert_array_equal(taught.positions[: len(samples)], samples)
    np.testing.assert_allclose(
        taught.forces[: len(samples)], forces(barrier, samples), rtol=1e-12
    )
    network = distil(small(kind, data), taught)
    assert relative(forces(network, taught.positions), taught.forces) < 0.01


@pytest.mark.parametrize("kind", KINDS)
def test_a_close_distillation_comes_nearer_to_its_teacher(scenario, data, kind):
    barrier = scenario.environment
    taught = distillation_targets(
        barrier, data, data.states, dim=2, width=0.5, how=OF_STRUCTURE
    )
    network = distil(small(kind, data), taught, OF_STRUCTURE)
    assert relative(forces(network, taught.positions), taught.forces) < 0.003


class Swinging(AbstractForce):
    """A force along x that swings in time, the same everywhere."""

    def __call__(self, t, x, v):
        return jnp.cos(t) * jnp.array([1.0, 0.0])


def test_a_network_that_sees_the_time_learns_a_force_that_swings(data):
    features = PositionTimeFeatures((5.0, 5.0, 2.5), (3.0, 3.0, 1.5))
    network = tanh_network(3, 2, width=8, depth=1, key=jax.random.key(0))
    force = NeuralForce(spread_weights(network), features)
    taught = distillation_targets(Swinging(), data, data.states, dim=2, width=0.5)
    found = distil(force, taught)
    points = data.states[0, :5, :2]
    for time in (0.0, 2.0, 4.0):
        expected = forces(Swinging(), points, time)
        np.testing.assert_allclose(forces(found, points, time), expected, atol=0.05)


@pytest.fixture(scope="module")
def fitted(scenario, data):
    model = eqx.tree_at(
        lambda m: (m.environment, m.drag.damping),
        scenario.truth,
        (small(NeuralPotential, data), 0.3),
    )
    return fit_bayes(model, data, learn=damping_of)


def test_a_network_learns_the_force_from_noisy_crossings(fitted, scenario, data):
    assert fitted.outcome is Outcome.CONVERGED
    assert fitted.iterations <= 10
    assert fitted.hyperparameters.noise == pytest.approx(NOISE, rel=0.1)
    points = data.states[..., :2].reshape(-1, 2)
    true = forces(scenario.environment, points)
    learned = forces(fitted.model.environment, points)
    assert relative(learned, true) < 0.08
    inside = np.abs(learned - true) < 1.96 * fitted.posterior.force_sd(points)
    assert inside.mean() > 0.85
    assert isinstance(fitted.model.environment, NeuralPotential)


def test_a_constant_is_learned_beside_a_network(fitted):
    assert list(fitted.constants) == ["drag.damping"]
    damping = fitted.constants["drag.damping"]
    assert abs(damping.value - 0.36) < 3.0 * damping.sd
    assert damping.sd < 0.05


@pytest.mark.slow
def test_networks_drawn_from_the_posterior_spread_about_it(fitted):
    models = fitted.posterior.samples(5, key=jax.random.key(0))
    point = np.array([[5.0, 5.0]])
    draws = np.stack([forces(model.environment, point) for model in models])
    assert np.all(np.isfinite(draws))
    assert np.all(draws.std(axis=0) > 0)
    band = fitted.posterior.rollout_band(fitted.states[0, 0], np.linspace(0.0, 1.0, 11))
    assert np.all(np.isfinite(band.sd))


def test_the_bands_of_a_network_are_as_wide_as_its_errors(fitted, scenario, data):
    """A prior of one variance for all weights makes them five times too wide."""
    points = data.states[..., :2].reshape(-1, 2)
    miss = forces(fitted.model.environment, points)
    miss = miss - forces(scenario.environment, points)
    z = miss / fitted.posterior.force_sd(points)
    assert 0.4 < np.sqrt(np.mean(z**2)) < 2.0


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


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_network_that_sees_the_time_has_independent_weights(scenario, data):
    features = PositionTimeFeatures((5.0, 5.0, 2.5), (3.0, 3.0, 1.5))
    network = tanh_network(3, 2, width=6, depth=1, key=jax.random.key(0))
    force = NeuralForce(spread_weights(network), features)
    model = scenario.truth.with_environment(force)
    found = fit_bayes(model, data, max_iterations=1, throw=False)
    assert found.hyperparameters.shape.size == 0
    assert found.hyperparameters.amplitude > 0


def test_channels_must_be_those_of_the_features(scenario, data):
    model = scenario.truth.with_environment(small(KINDS[0], data))
    one_dim = Trajectories.from_arrays(
        data.times[0], data.states[0][:, [0, 2]], channels=("x", "vx")
    )
    with pytest.raises(InputError, match="expected 4 channels"):
        fit_bayes(model, one_dim)
