"""Diffusion, observation and drift of paths that a camera blurs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.refusals import refusals

from pinav.dynamics import BrownianSwimmer, OverdampedSwimmer
from pinav.errors import InputError
from pinav.evaluation import exact_forces
from pinav.fitting import (
    ConstantDiffusion,
    Estimate,
    KernelDiffusion,
    LearnedObservation,
    SlowReference,
    fit_langevin,
    profile_environment,
)
from pinav.forces import KernelAxis, KernelBasis, KernelProfile, Warp, ZeroForce
from pinav.systems import Observation
from pinav.trajectories import Trajectories

TURN = 2 * np.pi
EXPOSURE, ERROR, DIFFUSION = 0.6, 0.15, 0.5


def ring(seed, tracks=3, samples=800, interval=0.05):
    """Angles round a ring with a drift that varies, blurred and with errors."""
    rng, fine = np.random.default_rng(seed), 20
    step = interval / fine
    x = rng.uniform(0, TURN, tracks)
    seen = np.zeros((samples, tracks))
    for n in range(samples):
        exposed = []
        for i in range(fine):
            kick = np.sqrt(2 * DIFFUSION * step) * rng.normal(size=tracks)
            x = x + (1 + np.sin(x)) * step + kick
            if i >= (1 - EXPOSURE) * fine:
                exposed.append(x)
        error = ERROR * np.sqrt(2 * DIFFUSION * interval) * rng.normal(size=tracks)
        seen[n] = np.mean(exposed, axis=0) + error
    return np.arange(samples) * interval, seen


def trajectories(times, seen, scale=1.0, unit=1.0):
    states = [scale * column[:, None] for column in seen.T]
    return Trajectories.from_arrays(unit * times, states, channels=("angle",))


def fit(data, period, diffusion=None):
    environment = profile_environment(data, (KernelAxis(0, period),), across=12)
    model = OverdampedSwimmer(ZeroForce(), environment, 1.0)
    seen = LearnedObservation()
    return fit_langevin(
        model, data, einstein=False, diffusion=diffusion, observation=seen
    )


TIMES, SEEN = ring(0)


@pytest.fixture(scope="module")
def fitted():
    return fit(trajectories(TIMES, SEEN), TURN)


def drift(fit, angles):
    return np.asarray(jax.vmap(lambda x: fit.model(0.0, x[None]))(angles))[:, 0]


def number(fit):
    assert isinstance(fit.thermal.diffusion, Estimate)
    return fit.thermal.diffusion


@pytest.mark.slow
def test_blur_and_error_do_not_bias_the_diffusion(fitted):
    diffusion = number(fitted)
    assert abs(diffusion.value - DIFFUSION) < 3 * diffusion.sd
    assert diffusion.sd < 0.05 * DIFFUSION
    assert fitted.constants["diffusion"] == diffusion
    assert set(fitted.constants) == {"diffusion", "exposure", "error"}
    assert fitted.thermal.checks.is_adequate, fitted.thermal.checks.statement


@pytest.mark.slow
def test_the_drift_is_within_its_band_and_periodic(fitted):
    angles = np.linspace(0, TURN, 25)
    miss = drift(fitted, angles) - (1 + np.sin(angles))
    sd = fitted.posterior.force_sd(angles[:, None])[:, 0]
    assert np.mean(np.abs(miss) < 2.5 * sd) > 0.8
    np.testing.assert_allclose(drift(fitted, angles + TURN), drift(fitted, angles))


@pytest.mark.slow
def test_units_the_order_of_tracks_and_whole_turns_change_nothing(fitted):
    turned = (SEEN % TURN)[:, ::-1]
    other = fit(trajectories(TIMES, turned, 1000.0, 60.0), 1000 * TURN)
    factor = 1000.0**2 / 60
    assert number(other).value == pytest.approx(factor * number(fitted).value, rel=1e-4)
    angles = np.linspace(0, TURN, 9)
    expected = 1000 / 60 * drift(fitted, angles)
    np.testing.assert_allclose(
        drift(other, 1000 * angles), expected, rtol=2e-3, atol=0.02
    )
    (axes,), (before,) = other.thermal.observation, fitted.thermal.observation
    assert axes.exposure.value == pytest.approx(60 * before.exposure.value, rel=1e-2)


def test_what_does_not_fit_together_is_refused():
    data = trajectories(TIMES[:20], SEEN[:20])
    environment = profile_environment(data, (KernelAxis(0, TURN),), across=6)
    model = OverdampedSwimmer(ZeroForce(), environment, 1.0)
    seen = LearnedObservation()
    with pytest.raises(InputError, match="expected a BrownianSwimmer"):
        fit_langevin(model, data, observation=seen, einstein=True)
    with pytest.raises(InputError, match="expected a thermal energy > 0"):
        fit_langevin(BrownianSwimmer(model, 0.0), data, observation=seen, einstein=True)
    wide = ConstantDiffusion(((0, 1), (2,)))
    with pytest.raises(InputError, match="expected each of 1 axes once"):
        fit(data, TURN, diffusion=wide)


PLACES, ALONG = np.linspace(0, 1, 5)[:, None], (KernelAxis(0),)
test_values_that_make_no_sense_are_refused = refusals(
    (lambda: ConstantDiffusion(((0, 2),)), "every axis from 0 on in one group"),
    (lambda: KernelDiffusion(()), "one or more KernelAxis, got none"),
    (lambda: Observation(exposure=-1.0), "Observation.exposure: expected 0 or more"),
    (lambda: LearnedObservation(spread=0.0), "LearnedObservation.spread: expected > 0"),
    (lambda: SlowReference(0, knots=1), "two or more knots"),
    (
        lambda: SlowReference(0, knots=3, start=(0.0, 1.0)),
        "start: expected 3 values.*, got 2",
    ),
    (lambda: KernelAxis(0, 1.0, Warp(0.0, 1.0)), "a period or a warp, got both"),
    (lambda: Warp(0.0, 0.0), "Warp.scale: expected > 0"),
    (
        lambda: KernelBasis.around(ALONG, PLACES, across=1),
        "across >= 3 and margin >= 1",
    ),
    (
        lambda: KernelBasis.around((KernelAxis(1),), PLACES),
        "KernelAxis.index: expected 0 to 0",
    ),
    (lambda: KernelBasis.around(ALONG, PLACES[:1]), "two or more different positions"),
    (
        lambda: KernelProfile.with_zero_weights(
            KernelBasis.around(ALONG, PLACES), (1,), 1
        ),
        "KernelProfile.along: expected one or more",
    ),
)


def test_a_force_along_a_warped_coordinate_is_even_or_that_of_a_potential_in_it():
    """Equal weights are a constant force, and a potential linear in u: its slope."""
    warp, heights = Warp(0.2, 0.05), np.geomspace(0.2, 3.0, 40)
    basis = KernelBasis.around((KernelAxis(0, warp=warp),), heights[:, None])
    ones = jnp.ones((len(basis.centers), 1))
    even, in_potential = (
        exact_forces(KernelProfile(weights, basis, (0,), 1), heights[:, None])[:, 0]
        for weights in (jnp.vstack([ones, 0 * ones]), jnp.vstack([0 * ones, ones]))
    )
    assert np.ptp(even) < 0.02 * even.mean()
    places = np.arcsinh((heights - warp.origin) / warp.scale)
    flat = (in_potential / np.gradient(places, heights))[1:-1]
    assert np.ptp(flat) < 0.02 * flat.mean()
    assert in_potential[0] == pytest.approx(even[0], rel=1e-6)
    with pytest.raises(InputError, match="KernelProfile.weights: expected 66 rows"):
        KernelProfile(ones, basis, (0,), 1)
