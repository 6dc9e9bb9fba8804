"""Short laws of what fits choose and judge by: moments, priors, thresholds, regions."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from tests.samples import stand_in

from pinav.fitting.bayes.function_prior import Process
from pinav.fitting.engine.posterior import Estimate
from pinav.fitting.environments.rates import force_region, forces_beside_drag
from pinav.fitting.langevin.checks import (
    LONGEST_EXPOSURE,
    SIGNIFICANT,
    SLIGHT,
    IncrementVerdict,
    LangevinChecks,
    ThinnedDiffusion,
)
from pinav.fitting.langevin.diffusion import (
    DiffusionField,
    ThermalMotion,
    diffusion_moments,
    observed_axes,
)
from pinav.fitting.langevin.increments import Increments, ObservedAxes
from pinav.fitting.matching.gauss_newton import Rates
from pinav.forces.kernel_basis import KernelBasis, KernelTensor
from pinav.forces.priors import StationaryPrior
from pinav.learning.plan import looks_brownian
from pinav.trajectories import Trajectories

RNG = np.random.default_rng(12)


@pytest.mark.parametrize("smooth", [True, False])
def test_the_steepness_of_a_prior_is_the_slope_of_its_logarithm(smooth):
    prior = StationaryPrior(np.zeros((3, 2)), 1.0, smooth=smooth)
    r, h = np.array([[0.2, 1.0], [3.0, 0.5]]), 1e-5
    falls = -(np.log(prior.correlation(r * (1 + h))) - np.log(prior.correlation(r))) / h
    assert np.allclose(prior.steepness(r), falls, rtol=1e-3)


def brownian(diffusion, error, count=8000, interval=0.5):
    steps = np.sqrt(2 * np.array(diffusion) * interval) * RNG.standard_normal(
        (count, 2)
    )
    seen = np.cumsum(steps, axis=0) + error * RNG.standard_normal((count, 2))
    times = interval * np.arange(float(count))
    return Trajectories.from_arrays(times, seen, channels=("x", "y"))


def test_the_first_guess_of_diffusion_leaves_out_the_error_of_positions():
    data = brownian((0.5, 2.0), 0.7)
    moments = diffusion_moments(Increments.of(data))
    assert np.allclose(moments, [0.5, 2.0], rtol=0.12)
    fine = brownian((1e-6, 1e-6), 1.0)
    steps = Increments.of(fine).steps
    plain = 0.5 * (steps**2).sum(axis=0) / (0.5 * len(steps))
    assert np.all(diffusion_moments(Increments.of(fine)) >= 0.0499 * plain)


@pytest.mark.parametrize(("error", "is_brownian"), [(0.0, True), (3.0, False)])
def test_paths_look_brownian_by_their_second_differences(error, is_brownian):
    assert looks_brownian(brownian((0.5, 0.5), error)) == is_brownian
    times = np.arange(300.0)
    smooth = np.stack([np.sin(times / 20), np.cos(times / 20)], axis=1)
    assert not looks_brownian(
        Trajectories.from_arrays(times, smooth, channels=("x", "y"))
    )


def test_forces_are_shrunk_by_the_likeliest_error():
    directions = np.diag([3.0, 2.0, 1.0, 0.5, 0.2, 0.1])[:, :5]
    values = directions @ np.array(
        [1.0, -1.0, 1.0, -1.0, 1.0]
    ) + 0.3 * RNG.standard_normal(6)
    process = stand_in(Process, directions=directions)
    signal = np.append(np.diag(directions[:5]) ** 2, 0.0)

    def loss(log_variance):
        total = signal + np.exp(log_variance)
        return np.sum(values**2 / total + np.log(total))

    best = minimize_scalar(loss, bounds=(-15, 5), method="bounded").x
    kept = signal / (signal + np.exp(best)) * values
    assert np.allclose(process.nearest(values), kept, atol=1e-3)


def test_diffusion_has_the_deviations_of_its_logarithm():
    tensor = KernelTensor(
        jnp.log(jnp.array([2.0, 0.5])),
        jnp.zeros((2, 0)),
        KernelBasis.constant(),
        ((0,), (1,)),
    )
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    field = DiffusionField(tensor, covariance)
    places = np.zeros((1, 2))
    assert np.allclose(field(places), [[2.0, 0.5]])
    assert np.allclose(field.sd(places), [[0.4, 0.15]])
    assert [one.sd for one in field.estimates()] == pytest.approx([0.4, 0.15])
    drawn = np.array([draw.levels for draw in field.samples(4000)])
    assert np.allclose(np.cov(drawn.T), covariance, atol=0.005)
    motion = ThermalMotion(
        tensor, jnp.array([0.0, 1.0]), jnp.log(jnp.array([4.0, 9.0])), 0.2, jnp.ones(2)
    )
    first, second = observed_axes(motion, np.array([0.1, 0.2]), np.array([0.3, 0.4]))
    assert np.allclose([first.exposure.value, first.exposure.sd], [0.1, 0.1 * 0.1 / 2])
    share = 1 / (1 + np.exp(-1))
    assert np.allclose(second.exposure.sd, 0.2 * 0.2 * share * (1 - share))
    assert np.allclose([second.error.value, second.error.sd], [3.0, 0.5 * 0.4 * 3])


def checks(**changes):
    exposure = ObservedAxes((0,), Estimate(0.1, 0.01), Estimate(0.1, 0.01), 1.0)
    thinned = ThinnedDiffusion(4, (0,), Estimate(1.0, 0.01))
    whole = LangevinChecks(np.zeros((5, 2)), 10**8, (thinned,), (exposure,))
    return dataclasses.replace(whole, **changes)


def test_a_langevin_fit_fails_beyond_each_limit_alone():
    assert checks().is_adequate
    assert checks(counts=400).band == 0.1
    for size, fails in ((SLIGHT - 1e-3, 0), (SLIGHT + 1e-3, 1)):
        correlations = np.zeros((5, 2))
        correlations[2, 1] = -size
        assert len(checks(correlations=correlations).failures) == fails
    correlations = np.zeros((5, 2))
    correlations[2, 1] = SIGNIFICANT / 20 * 0.99
    assert checks(correlations=correlations, counts=400).is_adequate
    correlations[2, 1] = SIGNIFICANT / 20 * 1.01
    (words,) = checks(correlations=correlations, counts=400).failures
    assert "axis 1" in words
    assert "3 samples apart" in words
    for excess, fails in ((-1e-3, 0), (1e-3, 1)):
        ratio = Estimate(1 + SIGNIFICANT * 0.01 + SLIGHT + excess, 0.01)
        thinned = (ThinnedDiffusion(4, (0,), ratio),)
        assert len(checks(thinned=thinned).failures) == fails
        long = Estimate(2 * (LONGEST_EXPOSURE + excess), 0.1)
        observed = (ObservedAxes((0,), long, Estimate(0.1, 0.1), 2.0),)
        assert len(checks(observation=observed).failures) == fails


@pytest.mark.parametrize(
    ("correlations", "thermal", "words"),
    [
        ((-0.5, 0.0, 0.0), True, "with an error of"),
        ((-0.501, 0.0, 0.0), False, "no thermal motion"),
        ((0.269, 0.0, 0.0), True, "blurred over 1.05"),
        ((0.271, 0.0, 0.0), False, "no thermal motion"),
        ((0.1, 0.099, 0.0), True, "blurred over 0.50"),
        ((0.1, 0.0, 0.101), False, "no thermal motion"),
        ((-0.25, 0.0, 0.0), True, "an error of 0.71 of a step"),
        ((SIGNIFICANT / 100 * 0.99, 0.0, 0.0), True, "without visible blur"),
        ((SIGNIFICANT / 100 * 1.01, 0.0, 0.0), True, "blurred"),
    ],
)
def test_increments_are_judged_on_both_sides_of_each_limit(
    correlations, thermal, words
):
    verdict = IncrementVerdict(correlations, 10_000, 0.1, 0.1)
    assert verdict.is_thermal == thermal
    assert words in verdict.statement
    assert (
        "too long" in dataclasses.replace(verdict, relaxed=0.31).statement
        or not thermal
    )


def test_the_region_of_a_force_is_weighted_by_its_size():
    positions = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 2.0], [9.0, 9.0]])
    forces = np.array([[1.0, 0.0], [0.0, 2.0], [3.0, 4.0], [0.0, 0.0]])
    states = np.hstack([positions, np.zeros((4, 2))])
    rates = Rates(np.arange(4.0), states, np.ones((4, 4)), None)
    region = force_region(rates, forces)
    weights = np.array([1, 2, 5, 0]) / 8
    center = weights @ positions
    assert np.allclose(region.center, center)
    squares = weights @ (positions - center) ** 2
    assert np.isclose(region.radius, np.sqrt(squares.mean()))
    velocities = RNG.standard_normal((200, 2))
    left = np.zeros((200, 2))
    left[:10] = 5.0
    total = 0.3 - 0.7 * velocities + left
    assert np.allclose(forces_beside_drag(velocities, total), left, atol=0.02)
