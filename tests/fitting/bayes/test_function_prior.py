"""A Gaussian process as the prior of a network, in its tangent space."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.fitting.problems import quadratic_of

from pinav.fitting.bayes.distillation import DistillationTargets, forces
from pinav.fitting.bayes.function_prior import Process, TangentWeights
from pinav.fitting.engine.local_model import (
    AbstractLocalModel,
    ConstantPriors,
    PenalisedSquares,
    Prediction,
)
from pinav.fitting.engine.problem import ShortenedStep
from pinav.fitting.evidence.evidence import (
    Hyperparameters,
    LinearisedObservations,
    evidence_of_scales,
    weight_posterior,
)
from pinav.fitting.evidence.quadratic import Quadratic
from pinav.forces import (
    CentralTerm,
    KernelPotential,
    NeuralPotential,
    PositionFeatures,
    StructuredForce,
    tanh_network,
)

NOISE, AMPLITUDE = 0.05, 1.5
GRID = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=-1).reshape(-1, 2)


@pytest.fixture(scope="module")
def kernels():
    weights = np.random.default_rng(0).normal(size=len(GRID))
    return KernelPotential(jnp.asarray(weights), jnp.asarray(GRID), 1.0)


@pytest.fixture(scope="module")
def places(kernels):
    positions = jnp.asarray(np.random.default_rng(1).uniform(-0.5, 3.5, (60, 2)))
    times = jnp.zeros(60)
    return DistillationTargets(times, positions, forces(kernels, times, positions))


@pytest.fixture(scope="module")
def process(kernels, places):
    prior = kernels.prior()
    chosen = Hyperparameters(prior.start, AMPLITUDE, NOISE, 0.0)
    shapes = np.random.default_rng(2).normal(size=(len(GRID), 2))
    return Process.of(kernels, prior, chosen, places, shapes)


@pytest.fixture(scope="module")
def quadratic():
    """Of data that determine some directions of the weights well, others not at all."""
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(8, len(GRID))) * np.geomspace(1.0, 1e-3, 8)[:, None]
    residuals = rows @ rng.normal(size=len(GRID)) + NOISE * rng.normal(size=8)
    own = quadratic_of(rows, -residuals)
    return dataclasses.replace(
        own, squares=own.squares + 0.3, num_free=100, log_determinant=1.7
    )


def slopes(kernels, places):
    def of(weights):
        own = KernelPotential(weights, kernels.centers, kernels.width)
        return forces(own, places.times, places.positions).ravel()

    return np.asarray(jax.jacrev(of)(kernels.weights))


def about(kernels, places, process, misfit=1e-4):
    """Kernels as if they were a network, with a given misfit."""
    wanted = np.asarray(places.forces).ravel()
    made = TangentWeights.of(kernels, places, process, wanted)
    size = len(wanted)
    return TangentWeights(made.free, made.point, places, process, np.full(size, misfit))


def test_a_network_that_is_linear_has_the_posterior_of_the_process(
    kernels, places, process, quadratic
):
    """Kernels, taken for a network: their own prior comes out."""
    found = about(kernels, places, process).about(np.zeros(len(GRID)))
    inference = found.infer(quadratic, found.start, None)
    data, chosen = LinearisedObservations.of(quadratic), process.chosen
    prior = kernels.prior().covariance(chosen.shape)
    mean, covariance = weight_posterior(data, prior, chosen)
    to_force = slopes(kernels, places)
    expected = to_force @ covariance @ to_force.T
    size = np.abs(expected).max()
    np.testing.assert_allclose(
        to_force @ inference.covariance @ to_force.T, expected, atol=1e-5 * size
    )
    np.testing.assert_allclose(to_force @ inference.mean, to_force @ mean, atol=1e-4)
    evidence = evidence_of_scales(data, prior)(AMPLITUDE, NOISE)
    assert inference.hyperparameters.log_evidence == pytest.approx(evidence, abs=0.05)
    again = found.posterior(quadratic, chosen)[1]
    np.testing.assert_array_equal(again, inference.covariance)


def test_the_process_of_a_structured_force_has_the_variance_of_its_parts(
    kernels, places
):
    center, radii = jnp.array([1.0, 1.2]), jnp.arange(0.5, 4.0)
    term = CentralTerm(jnp.ones(4), center, radii, 1.0)
    force = StructuredForce((term,), kernels)
    prior = force.prior()
    shape = np.concatenate([term.prior().start, kernels.prior().start, [-2.0]])
    chosen = Hyperparameters(shape, AMPLITUDE, NOISE, 0.0)
    count = term.weights.size + kernels.weights.size
    found = Process.of(force, prior, chosen, places, np.zeros((count, 0)))

    def values(weights, moved):
        own = CentralTerm(weights, moved, radii, 1.0)
        return forces(own, places.times, places.positions).ravel()

    by_weight, by_center = jax.jacrev(values, (0, 1))(term.weights, center)
    terms, rest, ratio = prior.split(shape)
    own = by_weight @ term.prior().covariance(terms) @ by_weight.T
    to_force = slopes(kernels, places)
    remainder = to_force @ kernels.prior().covariance(rest) @ to_force.T
    expected = AMPLITUDE**2 * (own + ratio**2 * remainder)
    expected += term.geometry_scales[0] ** 2 * by_center @ by_center.T
    np.testing.assert_allclose(
        found.directions @ found.directions.T,
        expected,
        atol=1e-5 * np.abs(expected).max(),
    )


def test_the_energy_is_that_of_the_forces(kernels, places, process):
    found = about(kernels, places, process, misfit=0.2)
    values = np.asarray(places.forces).ravel()
    covariance = process.directions @ process.directions.T + 0.04 * np.eye(len(values))
    expected = values @ np.linalg.solve(covariance, values)
    assert found.energy(np.asarray(kernels.weights)) == pytest.approx(expected)


def test_changes_of_the_shape_are_changes_of_the_forces(
    kernels, places, process, quadratic
):
    found = about(kernels, places, process)
    weights = found.shape_covariance(quadratic, process.chosen, None)
    to_force = slopes(kernels, places)
    expected = process.shapes @ process.shapes.T
    np.testing.assert_allclose(
        to_force @ weights @ to_force.T, expected, atol=1e-6 * np.abs(expected).max()
    )


def test_the_nearest_field_keeps_what_the_process_can_be(process):
    rng = np.random.default_rng(4)
    field = process.directions @ rng.normal(size=process.directions.shape[1])
    size = np.sqrt(np.mean(field**2))
    np.testing.assert_allclose(process.nearest(field), field, atol=1e-3 * size)
    rough = field + 0.1 * size * rng.normal(size=field.shape)
    off = np.sqrt(np.mean((process.nearest(rough) - field) ** 2))
    assert off < 0.06 * size


def test_the_misfit_of_a_network_widens_its_prior(places, process):
    """An untrained network is off by as much as its forces are large."""
    features = PositionFeatures((1.5, 1.0), (1.0, 1.0))
    network = NeuralPotential(
        tanh_network(2, 1, width=8, depth=1, key=jax.random.key(0)), features, 30.0
    )
    wanted = np.asarray(places.forces).ravel()
    found = TangentWeights.of(network, places, process, wanted)
    values = np.asarray(forces(network, places.times, places.positions)).ravel()
    off = values - wanted
    smooth = len(values) / len(found.point)
    assert np.mean(found.misfit**2) == pytest.approx(smooth * np.mean(off**2), rel=0.3)
    assert found.misfit.min() > 0


class Bowl(AbstractLocalModel):
    """A fit whose cost is a parabola with its minimum at one."""

    quadratic: Quadratic

    def predict(self, theta):
        return Prediction(jnp.asarray(theta - 1.0), jnp.asarray(theta)[None, None])

    def pull_back(self, residuals):
        return np.asarray(residuals)

    def advance(self, mean):
        return jnp.asarray(mean)[None, None]

    def defect(self, mean, noise):
        return 0.0


def cost(noise):
    bowl = Bowl(quadratic_of(np.eye(1), np.ones(1)))
    return PenalisedSquares(bowl, np.zeros(1), noise, lambda _: 0.0, ConstantPriors())


@pytest.mark.parametrize(("mean", "reached"), [(0.9, 0.9), (3.0, 1.5), (-1.0, 0.0)])
def test_a_step_is_shortened_until_it_lowers_the_cost(mean, reached):
    move = ShortenedStep()(cost(1.0), np.array([mean]))
    np.testing.assert_allclose(move.theta, [reached])
    np.testing.assert_allclose(move.states, [[[reached]]])


def test_corrections_with_the_jacobian_held_reach_the_least_squares():
    """Where the linear model asks for too little; the bowl is least at one."""
    move = ShortenedStep(corrections=6)(cost(1e-3), np.array([0.4]))
    np.testing.assert_allclose(move.theta, [1.0], atol=1e-3)
