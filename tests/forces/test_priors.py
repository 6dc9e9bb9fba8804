"""Every prior of every learned force is a covariance, for any shape in its bounds."""

import equinox as eqx
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from tests.fitting.problems import quadratic_of
from tests.forces.examples import FORCES, TERMS

from pinav import forces
from pinav.fitting.environments.kernels import KernelGrid, surround_with_kernels
from pinav.fitting.evidence.evidence import (
    LinearisedObservations,
    best_hyperparameters,
    weight_posterior,
)
from pinav.fitting.evidence.weights import GaussianWeights
from pinav.forces.priors import (
    DistancePrior,
    IsotropicPrior,
    MixturePrior,
    ProfilePrior,
    WeightPrior,
)

CENTERS = np.random.default_rng(0).uniform(-3.0, 3.0, size=(9, 2))
STILL = forces.KernelPotential.with_zero_weights(CENTERS, 1.0)
LEARNED = {
    name: force
    for name, force in ((name, make()) for name, make in FORCES.items())
    if isinstance(force, forces.AbstractLearnedForce)
}
every_force = pytest.mark.parametrize("force", LEARNED.values(), ids=LEARNED)


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


@pytest.mark.parametrize(
    "force",
    [
        *LEARNED.values(),
        *(forces.StructuredForce((make(),), STILL) for make in TERMS.values()),
    ],
    ids=[*LEARNED, *TERMS],
)
def test_a_prior_has_the_pullback_of_its_covariance(force):
    """Compared with differences of the covariance, for some matrix."""
    prior, rng, step = force.prior(), np.random.default_rng(0), 1e-5
    shape = prior.start + rng.uniform(-0.3, 0.3, size=len(prior.start))
    count = len(prior.covariance(shape))
    pull = np.random.default_rng(0).normal(size=(count, count))
    pull += pull.T

    def value(at):
        return np.vdot(pull, prior.covariance(at))

    expected = [
        (value(shape + unit) - value(shape - unit)) / (2 * step)
        for unit in step * np.eye(len(shape))
    ]
    scale = np.abs(expected).max(initial=1.0)
    np.testing.assert_allclose(
        prior.pullback(shape, pull), expected, rtol=1e-6, atol=1e-7 * scale
    )


@every_force
def test_kernels_on_other_places_are_untrained_and_of_that_width(force):
    made = force.kernels_on(CENTERS[:4], 0.5)
    assert made.dim == force.dim == 2
    assert made.kernels.width == 0.5
    _, free = forces.split_structure(made)
    assert not np.any(jax.tree.leaves(free.parameters)[0])
    assert made.is_linear
    prior = made.prior()
    assert np.all(prior.bounds[:, 0] <= prior.start)
    assert np.all(prior.start <= prior.bounds[:, 1])


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
        central = forces.CentralTerm(
            jnp.zeros(5), jnp.zeros(2), unit * jnp.arange(0.5, 5.0), unit
        )
        others = {
            "linear": forces.LinearTerm(jnp.zeros(5), jnp.zeros(2), 2.0 * unit),
            "lattice": forces.LatticeTerm(
                jnp.zeros(12), jnp.eye(2) / unit, jnp.zeros(2)
            ),
            "hills": forces.HillsTerm(
                jnp.zeros(3), jnp.zeros((1, 2)), jnp.array([[np.log(unit), 0.0, 0.0]])
            ),
        }
        terms = (central, others[second]) if second in others else (central,)
        free = forces.KernelPotential.with_zero_weights(unit * CENTERS, unit)
        force = forces.StructuredForce(terms, free)
        prior, place = force.prior(), unit * jnp.array([1.3, -0.4])

        def at_place(parameters, force=force, place=place):
            whole = eqx.tree_at(lambda f: f.parameters, force, parameters)
            return whole(jnp.zeros(()), place, jnp.zeros(2))

        rows = jax.tree.leaves(jax.jacobian(at_place)(force.parameters))
        by_weight = np.concatenate([np.reshape(r, (2, -1)) for r in rows], axis=1)
        covariance = by_weight @ prior.covariance(prior.start) @ by_weight.T
        covariances.append(covariance)
    np.testing.assert_allclose(covariances[1], covariances[0], rtol=1e-5)


@pytest.mark.parametrize(
    "remainder",
    [STILL, forces.KernelMixture.with_zero_weights(CENTERS, 1.0)],
    ids=["U", "U, ψ"],
)
def test_free_kernels_beside_terms_are_no_hill(remainder):
    """Their envelope reaches over half of their extent at least, in the same place."""
    alone, beside = (
        remainder.prior(),
        forces.StructuredForce(LEARNED["structured"].terms, remainder).prior().second,
    )
    low = np.log(0.5 * np.ptp(CENTERS, axis=0).max())
    reaches = np.flatnonzero(alone.bounds[:, 0] != beside.bounds[:, 0])
    np.testing.assert_allclose(beside.bounds[reaches, 0], low)
    assert len(reaches) == len(alone.start) // len(STILL.prior().start)
    np.testing.assert_array_equal(alone.start, beside.start)


PLACES = np.linspace(0.5, 20.0, 40)
FADED = np.array([1.0, 0.5, -19.0])
"""A length scale of 2.7 widths, an envelope of 1.6 at the lower end."""


def test_a_floor_holds_the_variance_where_the_envelope_ends():
    without = ProfilePrior(PLACES, 0.5, floor=0.0).covariance(FADED)
    with_floor = ProfilePrior(PLACES, 0.5, floor=0.1).covariance(FADED)
    assert without[-1, -1] < 1e-12
    np.testing.assert_allclose(with_floor[-1, -1], 0.01, rtol=1e-9)
    np.testing.assert_allclose(with_floor[0, 0], without[0, 0] + 0.01)


def test_a_profile_is_matern_of_order_seven_halves():
    # The spectrum of that order is (7 / l^2 + k^2)^-4: its ratio at two frequencies.
    spacing, scale = 0.02, 1.0
    places = np.arange(-1500, 1501) * spacing
    a = np.sqrt(7.0) * np.abs(places) / scale
    prior = ProfilePrior(np.arange(3.0) * scale, 1.0, floor=0.0)
    alike = prior.covariance(np.array([0.0, 9.0, 0.0]))
    closed = (1 + a + 0.4 * a**2 + a**3 / 15) * np.exp(-a)
    at = len(places) // 2 + np.round(np.array([0, 1, 2]) * scale / spacing).astype(int)
    np.testing.assert_allclose(alike[0], closed[at], rtol=1e-6)
    spectrum = [spacing * closed @ np.cos(k * places) for k in (0.0, 5.0)]
    np.testing.assert_allclose(spectrum[1] / spectrum[0], (7 / 32) ** 4, rtol=1e-6)


def test_a_search_begins_at_the_likeliest_of_several_envelopes():
    # A hill near the origin, seen among places that reach far out of it.
    prior = MixturePrior(DistancePrior(ProfilePrior(PLACES, 0.5)), IsotropicPrior(1))
    starts = prior.starts
    assert len(starts) == 3
    np.testing.assert_array_equal(starts[0], prior.start)
    narrow = starts[2]
    rng = np.random.default_rng(0)
    root = np.linalg.cholesky(prior.covariance(narrow) + 1e-12 * np.eye(41))
    seen = root @ rng.normal(size=41) + 1e-3 * rng.normal(size=41)
    quadratic = quadratic_of(np.eye(41), seen)
    chosen = GaussianWeights(prior).first_shape(quadratic, None)
    np.testing.assert_array_equal(chosen, narrow)


def test_the_band_of_a_wall_covers_it_where_that_of_a_smooth_process_does_not():
    z, places = np.linspace(-5.0, 5.0, 120), np.arange(-6.0, 6.01, 0.4)
    truth = 1.5 / np.cosh(z / 0.6) ** 2
    rows = np.exp(-0.5 * ((z[:, None] - places) / 0.4) ** 2)
    few, endless = ProfilePrior(places, 0.4), WeightPrior(places[:, None], 0.4)
    shares = [share(few, rows, truth, seed) for seed in range(3)]
    assert 0.88 < np.mean(shares) < 0.99
    assert max(share(endless, rows, truth, seed) for seed in range(3)) < 0.5


def share(prior, rows, truth, seed) -> float:
    """Share of a profile that the band of 95 % covers, data everywhere."""
    seen = truth + 0.01 * np.random.default_rng(seed).normal(size=len(rows))
    data = LinearisedObservations.of(quadratic_of(rows, seen))
    chosen = best_hyperparameters(data, prior, prior.start)
    mean, covariance = weight_posterior(data, prior.covariance(chosen.shape), chosen)
    sd = np.sqrt(np.maximum(((rows @ covariance) * rows).sum(axis=1), 0.0))
    return float(np.mean(np.abs(rows @ mean - truth) < 1.96 * sd))
