"""Priors of constants: against closed forms and quadrature."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from tests.fitted_runs import crossing_system, crossings
from tests.fitting.problems import quadratic_of

from pinav.fitting import fit_bayes, kernel_environment, model_evidence
from pinav.fitting.engine.evidence_fit import iterate
from pinav.fitting.engine.local_model import ConstantPriors, wide_priors
from pinav.fitting.evidence.quadratic import eliminate_flat
from pinav.fitting.evidence.weights import NoWeights
from pinav.fitting.least_squares import Regression
from pinav.forces import KernelPotential
from pinav.systems.priors import FreeNumber, LogNormal, Normal

PRIORS = {"normal": Normal(0.7, 0.2), "log-normal": LogNormal(0.7, 0.3)}
NOISE = 0.5


def linear_problem():
    rng = np.random.default_rng(0)
    column = rng.normal(size=12)
    return column, 0.9 * column + NOISE * rng.normal(size=12)


def test_standardised_values_are_standard_deviations():
    for sign in (-1, 0, 1):
        normal = PRIORS["normal"].standard_score(0.7 + 0.2 * sign)
        assert float(normal) == pytest.approx(sign)
        skewed = PRIORS["log-normal"].standard_score(0.7 * np.exp(0.3 * sign))
        assert float(skewed) == pytest.approx(sign)


def test_a_normal_prior_of_a_constant_gives_the_exact_evidence_and_posterior():
    column, data = linear_problem()
    prior = PRIORS["normal"]
    added = ConstantPriors((0,), (prior,)).add_to(
        quadratic_of(column[:, None], data, np.array([0.3])), NOISE
    )
    reduced, block = eliminate_flat(added, np.array([True]))
    found = NoWeights().infer(reduced, np.zeros(0), NOISE).hyperparameters

    def joint(x):
        squares = np.sum((column * x - data) ** 2) / NOISE**2
        normalisation = -0.5 * len(data) * np.log(2 * np.pi * NOISE**2)
        height = prior.log_height - 0.5 * float(prior.standard_score(x)) ** 2
        return np.exp(normalisation - 0.5 * squares + height)

    evidence, _ = scipy.integrate.quad(joint, -3.0, 5.0, points=[0.8])
    assert found.log_evidence == pytest.approx(np.log(evidence), abs=1e-8)
    precision = column @ column / NOISE**2 + 1 / 0.2**2
    mean = (column @ data / NOISE**2 + 0.7 / 0.2**2) / precision
    assert block.offset[0] == pytest.approx(mean)
    assert NOISE**2 * block.covariance[0, 0] == pytest.approx(1 / precision)


@pytest.mark.slow
def test_the_evidence_of_a_first_step_does_not_depend_on_the_noise_before_it():
    column, data = linear_problem()
    values = []
    for first in (NOISE, 30 * NOISE):
        problem = Regression.of(
            jnp.asarray(0.3),
            lambda slope: column * slope - data,
            weights=lambda _: (),
            weights_prior=NoWeights(),
            constants=lambda slope: slope,
        )
        wide = wide_priors(problem.parametric, problem.theta, lambda m: [m], [100.0])
        problem = dataclasses.replace(problem, priors=wide, first_noise=first)
        values.append(iterate(problem, 1)[1][0].hyperparameters.log_evidence)
    assert values[0] == pytest.approx(values[1], abs=0.05)


@pytest.mark.slow
def test_a_tight_prior_holds_a_constant_and_a_wide_one_leaves_it():
    truth, data = crossing_system(3, 41).truth, crossings(41, count=3, key=1)
    true = float(truth.drag.damping)
    start = eqx.tree_at(
        lambda m: (m.environment, m.drag.damping),
        truth,
        (kernel_environment(KernelPotential, data), jnp.asarray(true)),
    )

    def fitted(learn):
        fit = fit_bayes(start, data, learn=learn, refine=None)
        evidence = model_evidence(fit.linear, fit.hyperparameters).log_evidence
        return fit.constants["drag.damping"], evidence

    def under(prior):
        return fitted((FreeNumber("drag.damping", prior),))

    free, flat = fitted(lambda m: m.drag.damping)
    held, _ = under(Normal(true + 5 * free.sd, 1e-3 * free.sd))
    assert held.value == pytest.approx(true + 5 * free.sd, abs=0.1 * free.sd)
    wide, evidence = under(LogNormal(free.value, 10.0))
    assert evidence == pytest.approx(flat, abs=0.1)
    assert wide.value == pytest.approx(free.value, abs=0.1 * free.sd)
    assert wide.sd == pytest.approx(free.sd, rel=0.05)
    between, _ = under(Normal(free.value, free.sd))
    assert between.sd == pytest.approx(free.sd / np.sqrt(2), rel=0.1)
