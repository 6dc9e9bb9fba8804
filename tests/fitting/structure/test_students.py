"""Networks in `fit_structured`: who teaches them, and what they learn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.fields.families import random_system

from pinav.dynamics import FixedStep
from pinav.fitting import (
    Outcome,
    fit_bayes,
    fit_structured,
    is_network,
    is_worth_a_search,
    neural_environment,
)
from pinav.fitting.bayes.function_prior import TangentWeights
from pinav.fitting.bayes.neural import FitSpecification
from pinav.fitting.structured import kernels_of_teacher
from pinav.forces import (
    KernelForce,
    KernelPotential,
    NeuralForce,
    NeuralPotential,
    PositionTimeFeatures,
    StructuredForce,
    forces_at,
    spread_weights,
    tanh_network,
)
from pinav.scenarios.viscous import box
from pinav.trajectories import simulate, with_velocities

SIZE = {"width": 16, "depth": 2}


def hill(count=6):
    """A Gaussian hill, and positions of swimmers near it."""
    truth = random_system("gaussian", 2).with_starts(count=count)
    return truth, simulate(truth, key=jax.random.key(2)).only(("x", "y"))


def network_in(truth, data, kind):
    made = neural_environment(kind, data, key=jax.random.key(0), dim=data.dim, **SIZE)
    return truth.swimmer.with_environment(made)


def sees_the_time(truth):
    features = PositionTimeFeatures((5.0, 5.0, 2.5), (3.0, 3.0, 1.5))
    network = spread_weights(tanh_network(3, 2, key=jax.random.key(0), **SIZE))
    return truth.swimmer.with_environment(NeuralForce(network, features))


def specification(model, data):
    complete = with_velocities(data)
    return FitSpecification(model, complete, lambda _: (), None, FixedStep())


def error(model, truth, data):
    places = jnp.asarray(data.positions.reshape(-1, 2)[::7])
    times = jnp.full(len(places), 1.0)
    true = forces_at(truth.environment, times, places)
    learned = forces_at(model.environment, times, places)
    return jnp.linalg.norm(learned - true) / jnp.linalg.norm(true)


def test_a_potential_teaches_what_may_turn_in_a_plane():
    truth, data = hill()
    for kind, weighs in ((NeuralPotential, False), (NeuralForce, True)):
        asked = specification(network_in(truth, data, kind), data)
        kernels, weigh_rotation = kernels_of_teacher(asked)
        assert isinstance(kernels, KernelPotential)
        assert weigh_rotation is weighs
    kernels, weigh_rotation = kernels_of_teacher(
        specification(sees_the_time(truth), data)
    )
    assert isinstance(kernels, KernelPotential)
    assert weigh_rotation


def test_in_space_kernels_of_its_own_kind_teach_a_network():
    truth = box().with_starts(count=2)
    data = simulate(truth, key=jax.random.key(0))
    asked = specification(network_in(truth, data, NeuralForce), data)
    kernels, weigh_rotation = kernels_of_teacher(asked)
    assert isinstance(kernels, KernelForce)
    assert not weigh_rotation


def test_a_network_is_worth_a_search_where_its_data_are():
    truth, data = hill()
    for model in (network_in(truth, data, NeuralForce), sees_the_time(truth)):
        assert is_network(model)
        assert is_worth_a_search(model, data)
        assert not is_worth_a_search(model, hill(2)[1])


@pytest.mark.slow
@pytest.mark.parametrize("kind", [NeuralPotential, NeuralForce])
def test_a_network_is_nearly_as_good_as_the_structured_fit_that_teaches_it(kind):
    truth, data = hill()
    found = fit_structured(network_in(truth, data, kind), data)
    assert found.fit.outcome is Outcome.CONVERGED
    assert isinstance(found.force, kind)
    assert found.structure is not None
    assert [term.kind for term in found.structure.terms] == ["central"]
    process = found.fit.linear.weights.process
    assert isinstance(process.kernels, StructuredForce)
    theirs = error(found.teacher.model, truth, data)
    assert error(found.fit.model, truth, data) < theirs + 0.01


@pytest.mark.slow
def test_a_network_that_sees_the_time_has_the_process_that_explains_a_still_force():
    truth, data = hill()
    found = fit_structured(sees_the_time(truth), data)
    assert isinstance(found.fit.linear.weights, TangentWeights)
    assert error(found.fit.model, truth, data) < 0.02


@pytest.mark.slow
def test_few_data_are_fitted_as_without_a_search():
    truth, _ = hill()
    few = hill(2)[1]
    model = network_in(truth, few, NeuralPotential)
    found = fit_structured(model, few, throw=False)
    assert found.teacher is None
    assert np.isnan(found.gain)
    assert found.structure is None
    alone = fit_bayes(model, few, throw=False)
    np.testing.assert_allclose(found.fit.posterior.mean, alone.posterior.mean)
