"""Every prior of every learned force is a covariance, for any shape in its bounds."""

import inspect

import equinox as eqx
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings

import pinav.forces
from pinav.fitting.environments.kernels import KernelGrid, surround_with_kernels
from pinav.forces import (
    AbstractLearnedForce,
    CentralTerm,
    ChangingPotential,
    HillsTerm,
    KernelAxis,
    KernelBasis,
    KernelForce,
    KernelMixture,
    KernelPotential,
    KernelProfile,
    KernelStream,
    LatticeTerm,
    LayeredPotential,
    LinearTerm,
    NeuralForce,
    NeuralPotential,
    PositionFeatures,
    StructuredForce,
    TimedKernelPotential,
    tanh_network,
)
from pinav.forces.priors import WeightPrior

CENTERS = np.random.default_rng(0).uniform(-3.0, 3.0, size=(9, 2))
STILL = KernelPotential.with_zero_weights(CENTERS, 1.0)
TIMED = TimedKernelPotential(jnp.zeros((9, 5)), jnp.asarray(CENTERS), 1.0, 0.0, 1.0)
FEATURES = PositionFeatures((0.0, 0.0), (1.0, 1.0))


def network(outputs):
    return tanh_network(2, outputs, width=3, depth=1, key=jax.random.key(0))


FORCES = {
    KernelForce: KernelForce.with_zero_weights(CENTERS, 1.0),
    KernelPotential: STILL,
    KernelStream: KernelStream.with_zero_weights(CENTERS, 1.0),
    KernelMixture: KernelMixture.with_zero_weights(CENTERS, 1.0),
    KernelProfile: KernelProfile.with_zero_weights(
        KernelBasis.around((KernelAxis(0),), CENTERS, across=3, margin=1), (0, 1), 2
    ),
    LayeredPotential: LayeredPotential(
        (STILL, KernelPotential.with_zero_weights(CENTERS[:3], 0.5))
    ),
    TimedKernelPotential: TIMED,
    ChangingPotential: ChangingPotential(STILL, TIMED),
    NeuralForce: NeuralForce(network(2), FEATURES),
    NeuralPotential: NeuralPotential(network(1), FEATURES),
    StructuredForce: StructuredForce(
        (
            CentralTerm(jnp.zeros(5), jnp.zeros(2), jnp.arange(0.5, 5.0), 1.0),
            LinearTerm(jnp.zeros(5), jnp.zeros(2), 2.0),
        ),
        STILL,
    ),
}
every_force = pytest.mark.parametrize("force", FORCES.values(), ids=lambda f: type(f))


def test_every_learned_force_is_tried():
    kinds = {
        kind
        for _, kind in inspect.getmembers(pinav.forces, inspect.isclass)
        if issubclass(kind, AbstractLearnedForce) and not inspect.isabstract(kind)
    }
    assert kinds == set(FORCES)


@every_force
@given(data=st.data())
@settings(max_examples=15)
def test_a_prior_is_symmetric_and_positive_semidefinite(force, data):
    prior = force.prior()
    share = [data.draw(st.floats(0.0, 1.0)) for _ in prior.start]
    low, high = prior.bounds.T
    shape = low + np.asarray(share) * (high - low)
    covariance = prior.covariance(shape)
    leaves = jax.tree.leaves(force.parameters)
    size = sum(leaf.size for leaf in leaves if hasattr(leaf, "size"))
    assert covariance.shape == (size, size)
    np.testing.assert_array_equal(covariance, covariance.T)
    values = np.linalg.eigvalsh(covariance)
    assert values[0] > -1e-10 * max(values[-1], 1e-300)


@every_force
def test_kernels_on_other_places_are_untrained_and_of_that_width(force):
    made = force.kernels_on(CENTERS[:4], 0.5)
    assert made.dim == force.dim == 2
    assert made.kernels.width == 0.5
    assert not np.any(jax.tree.leaves(made.parameters)[0])
    assert made.is_linear


@every_force
def test_length_scales_and_prior_need_no_weights(force):
    """A fit asks the fixed part of a model, from which the weights are taken out."""
    if not force.is_linear:
        pytest.skip("the prior of a network is over its weights")
    weights = jax.tree.leaves(force.parameters)
    fixed = jax.tree.map(
        lambda leaf: None if any(leaf is w for w in weights) else leaf, force
    )
    shape = force.prior().start
    assert fixed.length_scales(shape) == force.length_scales(shape)


def test_the_middle_of_an_envelope_lies_where_data_are():
    """Kernels are laid four spacings beyond the data, in which it does not lie."""
    positions = np.random.default_rng(1).uniform(0.0, 12.0, (400, 2))
    centers, width = surround_with_kernels(positions, KernelGrid())
    prior = WeightPrior(centers, width)
    middle = (centers.min(axis=0) + centers.max(axis=0)) / 2
    for corner in (middle + width * bound for bound in prior.bounds[2:].T):
        assert np.all(corner < positions.max(axis=0) + width)
        assert np.all(corner > positions.min(axis=0) - width)


@pytest.mark.parametrize("second", ["linear", "lattice", "hills", "kernels"])
def test_the_unit_of_length_decides_nothing_between_parts_of_a_force(second):
    """One shape of the prior means the same forces in any unit of length."""
    covariances = []
    for unit in (1.0, 1000.0):
        central = CentralTerm(
            jnp.zeros(5), jnp.zeros(2), unit * jnp.arange(0.5, 5.0), unit
        )
        others = {
            "linear": LinearTerm(jnp.zeros(5), jnp.zeros(2), 2.0 * unit),
            "lattice": LatticeTerm(jnp.zeros(12), jnp.eye(2) / unit, jnp.zeros(2)),
            "hills": HillsTerm(
                jnp.zeros(3), jnp.zeros((1, 2)), jnp.array([[np.log(unit), 0.0, 0.0]])
            ),
        }
        terms = (central, others[second]) if second in others else (central,)
        free = KernelPotential.with_zero_weights(unit * CENTERS, unit)
        force = StructuredForce(terms, free)
        prior, place = force.prior(), unit * jnp.array([1.3, -0.4])

        def at_place(parameters, force=force, place=place):
            whole = eqx.tree_at(lambda f: f.parameters, force, parameters)
            return whole(jnp.zeros(()), place, jnp.zeros(2))

        rows = jax.tree.leaves(jax.jacobian(at_place)(force.parameters))
        by_weight = np.concatenate([np.reshape(r, (2, -1)) for r in rows], axis=1)
        covariance = by_weight @ prior.covariance(prior.start) @ by_weight.T
        covariances.append(covariance)
    np.testing.assert_allclose(covariances[1], covariances[0], rtol=1e-5)


@pytest.mark.parametrize("remainder", [STILL, FORCES[KernelMixture]], ids=["U", "U, ψ"])
def test_free_kernels_beside_terms_are_no_hill(remainder):
    """Their envelope reaches over half of their extent at least, in the same place."""
    alone, beside = (
        remainder.prior(),
        StructuredForce(FORCES[StructuredForce].terms, remainder).prior().second,
    )
    low = np.log(0.5 * np.ptp(CENTERS, axis=0).max())
    reaches = np.flatnonzero(alone.bounds[:, 0] != beside.bounds[:, 0])
    np.testing.assert_allclose(beside.bounds[reaches, 0], low)
    assert len(reaches) == len(alone.start) // len(STILL.prior().start)
    np.testing.assert_array_equal(alone.start, beside.start)
