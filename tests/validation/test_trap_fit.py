"""A trapped bead: propagators and likelihood against dense Gaussians, and the fit."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import dblquad
from scipy.signal import lfilter
from tests.defects import told
from validation.truth import trap_fit

TRAP = trap_fit.TrapModel(*map(jnp.asarray, (0.4, 1.3, 0.6, 0.2, 0.5, 20.0)))


def covariance(trap: trap_fit.TrapModel, times: np.ndarray) -> np.ndarray:
    """Of recorded positions, from the autocorrelation of the bead alone."""
    rate, exposure = float(trap.rate), float(trap.exposure)
    gaps = np.abs(times[:, None] - times[None])
    ratio = rate * exposure
    apart = 2 * (np.cosh(ratio) - 1) / ratio**2 * np.exp(-rate * gaps)
    same = 2 * (ratio - 1 + np.exp(-ratio)) / ratio**2
    bead = float(trap.diffusion) / rate * np.where(gaps == 0, same, apart)
    slow = float(trap.wander) ** 2 * np.exp(-gaps / float(trap.memory))
    return bead + slow + float(trap.error) ** 2 * np.eye(len(times))


def restricted_likelihood(matrix, values):
    """Of a Gaussian with an unknown mean under a flat prior, and that mean."""
    inverse, ones = np.linalg.inv(matrix), np.ones(len(values))
    information = ones @ inverse @ ones
    mean = ones @ inverse @ values / information
    rest = values - mean
    size = len(values) - 1
    determinant = np.linalg.slogdet(matrix)[1] + np.log(information)
    return -0.5 * (rest @ inverse @ rest + determinant + size * np.log(2 * np.pi)), mean


EVEN = np.arange(40.0)
LOST = np.delete(EVEN, [3, 4, 11, 25, 26, 27]) + 0.03 * np.sin(np.arange(34.0))


@pytest.mark.parametrize(
    ("times", "even"), [(EVEN, True), (LOST, False)], ids=["even", "frames lost"]
)
def test_the_filter_gives_the_likelihood_of_a_dense_gaussian(times, even):
    values = np.random.default_rng(0).normal(size=len(times)) * 2
    data = trap_fit.TrapData(*map(jnp.asarray, (times, values, 0 * times)), even)
    result = trap_fit.trap_likelihood(TRAP, data)
    expected, mean = restricted_likelihood(covariance(TRAP, times), values)
    assert_allclose(result.log_likelihood, expected, rtol=1e-10)
    assert_allclose(result.mean, mean, rtol=1e-8)


@pytest.mark.parametrize("ratio", [1e-8, 0.0099, 0.0101, 0.5, 3.0])
def test_the_blurred_variance_is_that_of_wong_and_halvorsen(ratio):
    def correlation(s, r):
        return np.exp(-ratio * abs(s - r))

    halves = dblquad(correlation, 0, 1, 0, lambda s: s)[0]
    assert_allclose(trap_fit.blur_factor(ratio), 2 * halves, rtol=1e-7)


@pytest.mark.parametrize("exposure", [1e-3, 0.0748, 0.0752, 0.6, 0.999])
def test_what_stationary_beads_gain_keeps_them_stationary(exposure):
    trap = TRAP._replace(exposure=jnp.asarray(exposure))
    steps = trap_fit.propagate(trap, jnp.array([1.0, 2.5]))
    variance = trap.diffusion / trap.rate
    assert_allclose(steps.decay**2 * variance + steps.noise, variance)
    blurred = variance * trap_fit.blur_factor(trap.rate * trap.exposure)
    gained = steps.reach**2 * variance + steps.blurred
    assert_allclose(gained, jnp.full(2, blurred), rtol=1e-12)


def test_a_bead_follows_a_steady_drive_at_the_distance_of_the_lag():
    times = np.arange(50.0)
    data = trap_fit.TrapData(
        *map(jnp.asarray, (times, 0 * times, 3 * times)), even=True
    )
    behind = data.drive - data.mean_path(TRAP)
    lag = 3 / TRAP.rate + 3 * TRAP.exposure / 2
    assert_allclose(behind, jnp.full(50, lag), rtol=1e-12)


def recording(seed, frames=3000, rate=40.0, diffusion=0.2):
    """Positions [um] at 145 Hz, exposed for 0.6 frames, with an error of 5 nm."""
    random, parts, tau = np.random.default_rng(seed), 10, 1 / 145
    path = relaxing(random, frames * parts, np.exp(-rate * tau / parts))
    path *= np.sqrt(diffusion / rate)
    exposed = path.reshape(frames, parts)[:, -6:].mean(axis=1)
    return np.arange(frames) * tau, exposed + 0.005 * random.normal(size=frames)


def relaxing(random, count, decay):
    """An Ornstein-Uhlenbeck process of unit variance at equal times."""
    kicks = random.normal(size=count)
    kicks[1:] *= np.sqrt(1 - decay**2)
    return lfilter([1.0], [1.0, -decay], kicks)


def test_a_fit_finds_the_trap_and_does_not_depend_on_the_units():
    times, positions = recording(1)
    fit = trap_fit.fit_trap(times, positions, wander=False)
    assert fit.converged
    for estimate, true in ((fit.rate, 40.0), (fit.diffusion, 0.2)):
        assert abs(estimate.value - true) < 3 * estimate.sd < 0.4 * true
    stiffness = fit.stiffness(0.004)
    assert_allclose(stiffness.value, 0.004 * fit.rate.value / fit.diffusion.value)
    assert abs(stiffness.value - 0.8) < 3 * stiffness.sd
    assert_allclose(fit.lag(-2.0).value, -2 * fit.relaxation.value)
    assert fit.lag(-2.0).sd > 0
    assert np.all(np.abs(fit.correlations) < 4 / np.sqrt(3000))
    other = trap_fit.fit_trap(1e3 * times + 7, 1e-6 * positions - 2e-3, wander=False)
    assert_allclose(other.rate.value, fit.rate.value / 1e3, rtol=1e-3)
    assert_allclose(other.diffusion.sd, fit.diffusion.sd * 1e-15, rtol=1e-2)
    assert_allclose(other.mean.value, 1e-6 * fit.mean.value - 2e-3, rtol=1e-6)


def test_the_evidence_sees_that_a_trap_wanders():
    times, positions = recording(2)
    slow = 0.04 * relaxing(np.random.default_rng(3), len(times), 0.995)
    wandering = trap_fit.fit_trap(times, positions + slow)
    assert wandering.advantage > 5
    assert wandering.wander is not None
    assert abs(wandering.wander.value - 0.04) < 3 * wandering.wander.sd
    resting = trap_fit.fit_trap(times, positions)
    assert resting.advantage < 1
    if resting.advantage < 0:
        assert resting.wander is None


@pytest.mark.parametrize(
    ("times", "positions", "message"),
    [
        (np.arange(10.0), np.arange(10.0), "30 or more times"),
        (np.arange(40.0), np.full(40, np.nan), "finite numbers; leave lost frames out"),
        (-np.arange(40.0), np.arange(40.0), "expected increasing ones"),
        (np.arange(40.0), np.ones(40), "expected ones that change"),
    ],
)
def test_what_is_no_recording_of_a_trap_is_refused(times, positions, message):
    with told(message):
        trap_fit.fit_trap(times, positions)
