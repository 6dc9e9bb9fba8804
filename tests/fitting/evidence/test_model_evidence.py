"""Priors of kernel weights, their derivatives, and the evidence that they have."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.special
import scipy.stats
from tests.fitting.problems import STATES, quadratic_of

from pinav.errors import InputError
from pinav.fitting import LinearFit, model_evidence, timed_kernel_environment
from pinav.fitting.engine.local_model import ConstantPriors
from pinav.fitting.evidence.evidence import (
    Hyperparameters,
    LinearisedObservations,
    Whitened,
    at_shape,
    evidence_of_scales,
    shape_slope,
)
from pinav.fitting.evidence.model_evidence import LOG_RANGE, evidence_without_second
from pinav.fitting.evidence.quadratic import eliminate_flat
from pinav.fitting.evidence.weights import GaussianWeights, NoWeights
from pinav.forces import KernelMixture, KernelPotential, TimedKernelPotential
from pinav.forces.priors import AbstractPrior, IsotropicPrior, MixturePrior
from pinav.systems.priors import Normal
from pinav.trajectories import Trajectories

RNG = np.random.default_rng(0)
CENTERS = RNG.uniform(-3, 3, size=(7, 2))
ENVIRONMENTS = {
    "potential": KernelPotential.with_zero_weights(CENTERS, 1.0),
    "mixture": KernelMixture.with_zero_weights(CENTERS, 1.0),
    "in time": TimedKernelPotential(
        jnp.zeros((7, 5)), jnp.asarray(CENTERS), 1.0, 0.0, 1.0
    ),
}
every_prior = pytest.mark.parametrize(
    "prior", [e.prior() for e in ENVIRONMENTS.values()], ids=list(ENVIRONMENTS)
)


def inside(prior):
    return prior.start + RNG.uniform(-0.3, 0.3, size=len(prior.start))


def problem(count, rows=60):
    """A random linear problem of so many weights."""
    design, noise = RNG.normal(size=(rows, count)), 0.1 * RNG.normal(size=rows)
    data = design @ RNG.normal(size=count) + noise
    return design, data, quadratic_of(design, data)


@every_prior
@pytest.mark.parametrize("noise", [None, 0.1])
def test_the_slope_of_the_evidence_is_its_derivative(prior, noise):
    shape, step = inside(prior), 1e-3
    data = LinearisedObservations.of(problem(len(prior.covariance(prior.start)))[2])
    chosen = at_shape(data, prior.covariance, shape, noise)
    white = Whitened.of(data, prior.covariance(shape))
    slope = shape_slope(data, white, chosen, prior)
    units = step * np.eye(len(shape))
    expected = [
        at_shape(data, prior.covariance, shape + unit, noise).log_evidence
        - at_shape(data, prior.covariance, shape - unit, noise).log_evidence
        for unit in units
    ]
    np.testing.assert_allclose(
        slope, np.array(expected) / (2 * step), rtol=1e-2, atol=1e-2
    )


def test_a_mixture_without_rotation_is_a_potential():
    mixture = ENVIRONMENTS["mixture"].prior()
    potential = ENVIRONMENTS["potential"].prior()
    shape = inside(potential)
    covariance = mixture.covariance(np.concatenate([shape, shape, [-30.0]]))
    np.testing.assert_allclose(covariance[:7, :7], potential.covariance(shape))
    np.testing.assert_allclose(covariance[7:], 0.0, atol=1e-20)


def test_a_long_time_makes_a_static_potential():
    timed, still = (ENVIRONMENTS[k].prior() for k in ("in time", "potential"))
    shape = inside(still)
    covariance = timed.covariance(np.append(shape, timed.bounds[-1, 1]))
    expected = np.kron(still.covariance(shape), np.ones((5, 5)))
    np.testing.assert_allclose(covariance, expected, atol=1e-8)


class Fixed(AbstractPrior):
    """A prior on which its two shape parameters have no effect, or all of it."""

    spread: float

    @property
    def start(self):
        return np.zeros(1)

    @property
    def bounds(self):
        return np.array([[-2.0, 2.0]])

    def covariance(self, shape):
        return np.exp(2 * self.spread * shape[0]) * np.eye(3)

    def pullback(self, shape, pull):
        return np.array([2 * self.spread * np.vdot(pull, self.covariance(shape))])


IDLE = Fixed(0.0)


def chosen_for(quadratic, noise=0.1, shape=(0.0,), prior=IDLE):
    """The fit with a prior, and its amplitude at a shape."""
    lines, shape = LinearisedObservations.of(quadratic), np.array(shape)
    chosen = at_shape(lines, prior.covariance, shape, noise)
    weights, rows = GaussianWeights(prior), quadratic.num_free
    return LinearFit(quadratic, weights, noise, rows, 0.0), chosen


def test_evidence_compares_models_by_their_marginal_likelihood():
    """Two priors of one data set: closed-form Gaussian marginal likelihoods."""
    design, data, quadratic = problem(3)
    linear, found = chosen_for(quadratic)
    exact = log_density(design, data, found.amplitude)
    np.testing.assert_allclose(found.log_evidence, exact, rtol=1e-9)
    exact = [log_density(design, data, amplitude) for amplitude in (1.0, 0.05)]
    best = [
        model_evidence(linear, Hyperparameters(np.zeros(1), amplitude, 0.1, value)).best
        for amplitude, value in zip((1.0, 0.05), exact, strict=True)
    ]
    np.testing.assert_allclose(np.subtract(*best), np.subtract(*exact), rtol=1e-10)


def log_density(design, data, amplitude, noise=0.1):
    covariance = amplitude**2 * design @ design.T + noise**2 * np.eye(len(data))
    factor = np.linalg.cholesky(covariance)
    white = scipy.linalg.solve_triangular(factor, data, lower=True)
    return -0.5 * (white @ white + np.log(2 * np.pi * np.diag(factor) ** 2).sum())


def test_hyperparameters_cost_the_logarithm_of_the_range_they_lose():
    """Against the integral over amplitude, by quadrature; an idle shape is free."""
    design, data, quadratic = problem(3)
    linear, chosen = chosen_for(quadratic)
    logs = np.log(chosen.amplitude) + np.linspace(-LOG_RANGE / 2, LOG_RANGE / 2, 401)
    values = np.array([log_density(design, data, np.exp(v)) for v in logs])
    exact = -np.log(np.mean(np.exp(values - chosen.log_evidence)))
    assert model_evidence(linear, chosen).correction == pytest.approx(exact, abs=0.3)


def test_a_part_that_is_not_needed_costs_the_share_of_ratios_at_which_it_vanishes():
    """Two parts with fixed shapes: the integral over the ratio, by quadrature."""
    design, _, _ = problem(4)
    data = design[:, :2] @ np.array([1.0, -0.7]) + 0.1 * RNG.normal(size=len(design))
    prior = MixturePrior(IsotropicPrior(2), IsotropicPrior(2), least_ratio=-12.0)
    linear, chosen = chosen_for(quadratic_of(design, data), 0.1, (-4.0,), prior)
    amplitudes = np.exp(np.linspace(-4.0, 4.0, 81)) * chosen.amplitude
    ratios = np.exp(np.linspace(*prior.bounds[0], 81))
    values = [
        [log_density(design * [1, 1, r, r], data, a) for r in ratios]
        for a in amplitudes
    ]
    exact = scipy.special.logsumexp(values) - np.log(np.size(values))
    assert evidence_without_second(linear, chosen) == pytest.approx(exact, abs=0.5)


def test_the_evidence_at_many_scales_asks_once_for_the_prior(monkeypatch):
    """By the closed form; most of the work is that of the prior, once for a shape."""
    design, data, quadratic = problem(3)
    at = evidence_of_scales(LinearisedObservations.of(quadratic), np.eye(3))
    scales = [(1.0, 0.1), (0.5, 0.1), (0.5, 0.2)]
    levels = np.array([at(*scale) for scale in scales])
    exact = np.array([log_density(design, data, *scale) for scale in scales])
    np.testing.assert_allclose(levels, exact, rtol=1e-9)

    asked, plain = [], Fixed.covariance

    def counted(prior, shape):
        asked.append(tuple(shape))
        return plain(prior, shape)

    fit = chosen_for(quadratic, None)
    monkeypatch.setattr(Fixed, "covariance", counted)
    model_evidence(*fit)
    assert asked
    assert len(asked) == len(set(asked))


def cost_of_a_constant(quadratic, noise, rows=40):
    """Evidence of a model with one constant and no weights."""
    reduced, _ = eliminate_flat(quadratic, np.array([True]))
    chosen = NoWeights().infer(reduced, np.zeros(0), noise).hyperparameters
    linear = LinearFit(reduced, NoWeights(), noise, rows, float(np.log(rows)))
    return model_evidence(linear, chosen).log_evidence


def test_a_flat_constant_costs_half_the_logarithm_of_the_data():
    """Unit information: as the Bayesian information criterion, in any unit."""
    column, data = RNG.normal(size=(40, 1)), RNG.normal(size=40)
    costs = [cost_of_a_constant(quadratic_of(u * column, data), 1.0) for u in (1, 1e3)]
    residual = data - column @ np.linalg.lstsq(column, data, rcond=None)[0]
    likelihood = scipy.stats.norm.logpdf(residual).sum()
    np.testing.assert_allclose(costs, likelihood - 0.5 * np.log(40), rtol=1e-10)


def test_a_wide_prior_of_a_constant_costs_what_a_flat_one_does():
    noise = 0.02
    flat = quadratic_of(RNG.normal(size=(40, 1)), noise * RNG.normal(size=40))
    wide = ConstantPriors((0,), (Normal(0.0, 100.0),)).add_to(flat, noise)
    costs = [cost_of_a_constant(one, noise) for one in (flat, wide)]
    assert costs[0] == pytest.approx(costs[1], abs=1e-3)


def test_kernels_in_time_keep_their_number_small():
    times = np.linspace(1.0, 9.0, 30)
    states = np.stack([times, np.sin(times), times, times], axis=1)
    data = Trajectories.from_arrays(times, states, channels=STATES)
    made = timed_kernel_environment(data, intervals=4, max_weights=700)
    assert made.weights.shape[1] == 7
    assert made.weights.size <= 700
    assert (made.first, made.last) == (1.0, 9.0)
    with pytest.raises(InputError, match="one or more intervals and 100 weights"):
        timed_kernel_environment(data, intervals=0)
