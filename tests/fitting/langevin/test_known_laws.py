"""Thermal motion whose drift and diffusion are known in closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.fitting.problems import in_a_trap

from pinav import fitting
from pinav.dynamics import BrownianSwimmer, OverdampedSwimmer
from pinav.errors import InputError
from pinav.evaluation import exact_forces
from pinav.fitting.langevin import Increments
from pinav.fitting.langevin.diffusion import DiffusionField
from pinav.fitting.langevin.drift import transitions
from pinav.fitting.langevin.increments import Relation
from pinav.forces import (
    HarmonicTrap,
    KernelAxis,
    KernelBasis,
    KernelForce,
    KernelTensor,
    LinearForce,
    ZeroForce,
)
from pinav.trajectories import Trajectories

TURN = 2 * np.pi
DIFFUSION, RATE = 0.5, 1.0
STEP = 0.005
"""Of the simulations [T]."""


def film(drift, diffusion, start, frames, *, exposed=1, error=0.0, seed=0):
    """Positions as a camera sees them, and the times of the frames.

    Args:
        drift: of positions (track, dim) at a time.
        diffusion: of positions.
        start: positions.
        frames: steps of the simulation at which frames end.
        exposed: steps over which a frame averages.
        error: standard deviation.
        seed: of kicks and errors.
    """
    rng, x, path = np.random.default_rng(seed), start, []
    for n in range(frames[-1]):
        kick = np.sqrt(2 * diffusion(x) * STEP) * rng.normal(size=x.shape)
        x = x + drift(n * STEP, x) * STEP + kick
        path.append(x)
    seen = [np.mean(path[end - exposed : end], axis=0) for end in frames]
    seen = np.array(seen) + error * rng.normal(size=(len(frames), *x.shape))
    return STEP * frames, seen.transpose(1, 0, 2)


def tracks(times, seen, observed=None):
    channels = ("x", "y", "z")[: seen.shape[2]]
    return Trajectories.from_arrays(
        [times] * len(seen), list(seen), channels=channels, observed=observed
    )


def number(fit):
    assert isinstance(fit.thermal.diffusion, fitting.Estimate)
    return fit.thermal.diffusion


def path_of(data, *axes, across=6, **options):
    """A fit of the drift along some axes, without a bond to the diffusion."""
    environment = fitting.profile_environment(data, axes, across=across)
    model = OverdampedSwimmer(ZeroForce(), environment, 1.0)
    return fitting.fit_langevin(model, data, einstein=False, **options)


LINE = OverdampedSwimmer(ZeroForce(), HarmonicTrap(RATE, [0.0]), 1.0)


def field(fit):
    assert isinstance(fit.thermal.diffusion, DiffusionField)
    return fit.thermal.diffusion


def drift(fit, points):
    at = jax.vmap(lambda x: fit.model(0.0, x))
    return np.asarray(at(jnp.asarray(points, jnp.float64)))


def trapped(interval, count=40, samples=400):
    """Exact paths along a line."""
    rng, times = np.random.default_rng(0), interval * np.arange(samples)
    path = in_a_trap(rng, times, (count, 1), RATE, DIFFUSION)
    return tracks(times, path.swapaxes(0, 1))


def pull(fit):
    """Rate at which the drift pulls towards zero, where the path mostly is."""
    points = np.linspace(-1.5, 1.5, 31)
    density = np.exp(-0.5 * RATE * points**2 / DIFFUSION)
    values = drift(fit, points[:, None])[:, 0]
    return -np.polyfit(points, values, 1, w=np.sqrt(density))[0]


FREE = Relation(thermal_energy=None, learn_diffusion=True, observation=None)


@pytest.mark.parametrize("tau", [0.01, 0.3, 1.0])
def test_steps_in_a_trap_are_those_of_the_exact_propagator(tau):
    places = np.array([[-0.8], [0.1], [0.6]])
    increments = Increments(
        np.zeros(3), places, np.zeros((3, 1)), np.full(3, tau), (3,)
    )
    tensor = KernelTensor(
        jnp.log(jnp.array([DIFFUSION])),
        jnp.zeros((1, 0)),
        KernelBasis.constant(),
        ((0,),),
    )
    step = transitions(LINE, tensor, increments, FREE)
    np.testing.assert_allclose(step.means, np.expm1(-RATE * tau) * places, rtol=1e-8)
    variance = -np.expm1(-2 * RATE * tau) / (2 * RATE * tau)
    np.testing.assert_allclose(step.factors, variance, rtol=1e-6)
    np.testing.assert_allclose(step.kept, np.exp(-RATE * tau), rtol=1e-8)


def test_steps_in_a_plane_turn_and_stretch_as_the_matrix_exponential_does():
    from scipy.integrate import quad_vec
    from scipy.linalg import expm

    matrix, tau = np.array([[-1.2, 0.9], [-0.6, 0.4]]), 0.7
    plane = OverdampedSwimmer(ZeroForce(), LinearForce(matrix, np.zeros(2)), 1.0)
    place, levels = np.array([[0.7, -0.3]]), jnp.log(jnp.array([0.5, 0.2]))
    increments = Increments(np.zeros(1), place, np.zeros((1, 2)), np.full(1, tau), (1,))
    tensor = KernelTensor(
        levels, jnp.zeros((2, 0)), KernelBasis.constant(), ((0,), (1,))
    )
    step = transitions(plane, tensor, increments, FREE)
    moved = expm(matrix * tau) @ place[0] - place[0]
    np.testing.assert_allclose(step.means[0], moved, rtol=1e-8)

    def spread(s):
        return expm(matrix * s) @ np.diag(2 * np.exp(levels)) @ expm(matrix.T * s)

    variance = np.diag(quad_vec(spread, 0.0, tau)[0])
    expected = variance / (2 * np.exp(levels) * tau)
    np.testing.assert_allclose(step.factors[0], expected, rtol=1e-5)


def test_the_likelihood_knows_what_the_diffusion_changes_in_terms_of_transitions():
    """Its derivative by level and weights, against differences of new terms."""
    places = np.linspace(-1.0, 1.0, 6)[:, None]
    count = len(places)
    increments = Increments(
        np.zeros(count), places, 0.01 * np.ones((count, 1)), np.full(count, 0.02), (6,)
    )
    basis = KernelBasis.around((KernelAxis(0),), places, across=4, margin=1)
    weights = jnp.linspace(-0.3, 0.4, len(basis.centers))[None]
    bound = Relation(thermal_energy=0.7, learn_diffusion=True, observation=None)
    for relation in (FREE, bound):

        def logarithms(numbers, relation=relation):
            tensor = KernelTensor(numbers[:1], numbers[None, 1:], basis, ((0,),))
            factors = transitions(LINE, tensor, increments, relation).factors
            return np.log(np.asarray(factors)[:, 0])

        numbers = jnp.concatenate([jnp.log(jnp.array([DIFFUSION])), weights[0]])
        tensor = KernelTensor(numbers[:1], weights, basis, ((0,),))
        slopes = transitions(LINE, tensor, increments, relation).slopes[:, 0]
        for index in range(len(numbers)):
            change = 1e-5 * jnp.eye(len(numbers))[index]
            difference = logarithms(numbers + change) - logarithms(numbers - change)
            np.testing.assert_allclose(slopes[:, index], difference / 2e-5, atol=1e-8)
    assert np.abs(slopes).max() > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("rate_times_interval", [0.3, 1.0])
def test_long_steps_do_not_bias_drift_or_diffusion(rate_times_interval):
    """Euler's scheme has 0.82 and 0.43 of the diffusion, 0.86 and 0.63 of the pull."""
    fit = path_of(trapped(rate_times_interval / RATE), KernelAxis(0))
    value = number(fit)
    assert abs(value.value - DIFFUSION) < 3 * value.sd < 0.1 * DIFFUSION
    assert pull(fit) == pytest.approx(RATE, rel=0.06)
    points = np.linspace(-1.0, 1.0, 21)[:, None]
    miss = drift(fit, points) + RATE * points
    sd = fit.posterior.force_sd(points)
    assert np.mean(np.abs(miss) < 1.96 * sd) > 0.7  # places share one error


def mobile(x):
    """Diffusion that varies round a ring: its logarithm by 0.6 sin x."""
    return DIFFUSION * np.exp(0.6 * np.sin(x))


FORCE = 0.8
"""A constant force round the ring, in units of the thermal energy."""


@pytest.fixture(scope="module")
def round_the_ring():
    """A constant force on a bead whose mobility varies, blurred and with errors."""

    def ito(time, x):
        return mobile(x) * (FORCE + 0.6 * np.cos(x))

    start = np.linspace(0, TURN, 24, endpoint=False)[:, None]
    frames = 10 * np.arange(1, 401)
    data = tracks(*film(ito, mobile, start, frames, exposed=6, error=0.03))
    axes = (KernelAxis(0, TURN),)
    kernels = fitting.profile_environment(data, axes, across=10)
    return fitting.fit_langevin(
        BrownianSwimmer(OverdampedSwimmer(ZeroForce(), kernels, 1.0), 1.0),
        data,
        diffusion=fitting.KernelDiffusion(axes, across=10),
        observation=fitting.LearnedObservation(),
        einstein=True,
    )


ANGLES = np.linspace(0, TURN, 24, endpoint=False)[:, None]


@pytest.mark.slow
def test_a_field_of_diffusion_is_learned_in_spite_of_blur_and_error(round_the_ring):
    diffusion = field(round_the_ring)
    values, log_sd = diffusion(ANGLES), diffusion.log_sd(ANGLES)
    miss = np.log(values / mobile(ANGLES))
    assert np.sqrt(np.mean(miss**2)) < 0.1
    assert np.mean(np.abs(miss) < 2.5 * log_sd) > 0.8
    np.testing.assert_allclose(diffusion.sd(ANGLES), values * log_sd)
    checks = round_the_ring.thermal.checks
    assert checks.is_adequate, checks.statement


@pytest.mark.slow
def test_the_divergence_of_the_diffusion_is_no_force(round_the_ring):
    """Left out, it would be a force of 0.6 cos x beside the constant one."""
    force = exact_forces(round_the_ring.model.environment, ANGLES)
    sd = round_the_ring.posterior.force_sd(ANGLES)
    assert np.mean(np.abs(force - FORCE) < 2.5 * sd) > 0.8
    assert force.mean() == pytest.approx(FORCE, abs=0.3)
    assert abs(2 * np.mean(force * np.cos(ANGLES))) < 0.3
    energy = round_the_ring.thermal.thermal_energy
    brownian = BrownianSwimmer(round_the_ring.model, energy)
    np.testing.assert_allclose(
        brownian.diffusion(jnp.asarray(ANGLES[0]))[0],
        field(round_the_ring)(ANGLES[:1])[0],
    )


@pytest.mark.slow
def test_a_reference_that_drifts_is_followed_from_two_starts():
    """A trap that wanders by more than its width; begun at rest and on its path."""

    def trap(time):
        return 0.6 * np.sin(TURN * time / 40)

    times, seen = film(
        lambda time, x: -4 * (x - trap(time)),
        lambda x: DIFFUSION,
        np.zeros((4, 1)),
        10 * np.arange(1, 801),
    )
    data = tracks(times, seen)

    def follow(start=None):
        reference = fitting.SlowReference(0, knots=16, start=start)
        found = path_of(data, KernelAxis(0), reference=reference).thermal.reference
        assert found is not None
        return found

    path = follow()
    truth = trap(path.times) - trap(path.times).mean()
    miss = path(path.times) - truth
    wide = 0.4 * np.sqrt(np.mean(truth**2))
    assert np.sqrt(np.mean(miss**2)) < wide
    assert np.all(path.sd < np.std(truth))
    apart = follow(truth).values - path.values
    assert np.sqrt(np.mean(apart**2)) < wide


@pytest.mark.slow
def test_irregular_times_and_lost_frames_in_space():
    """A spring along z, and a diffusion along it that is not that across."""
    levels = np.array([0.5, 0.5, 0.2])
    rng = np.random.default_rng(1)
    frames = np.cumsum(rng.integers(8, 14, 400))
    times, seen = film(
        lambda time, x: -RATE * x * np.array([0, 0, 1]),
        lambda x: levels,
        np.zeros((10, 3)),
        frames,
        exposed=5,
        error=0.03,
    )
    observed = np.repeat(rng.random((10, 400, 1)) > 0.15, 3, axis=2)
    data = tracks(times, seen, list(observed))
    fit = path_of(
        data,
        KernelAxis(2),
        diffusion=fitting.ConstantDiffusion(((0, 1), (2,))),
        observation=fitting.LearnedObservation(),
    )
    for estimate, level in zip(field(fit).estimates(), levels[1:], strict=True):
        assert abs(estimate.value - level) < 3 * estimate.sd
        assert estimate.sd < 0.06 * level
    assert set(fit.constants) >= {"diffusion[0,1]", "diffusion[2]", "error[2]"}
    heights = np.linspace(-0.6, 0.6, 13)
    points = np.stack([0 * heights, 0 * heights, heights], axis=1)
    sd = fit.posterior.force_sd(points)[:, 2]
    assert np.mean(np.abs(drift(fit, points)[:, 2] + RATE * heights) < 2.5 * sd) > 0.8
    assert not drift(fit, points)[:, :2].any()


@pytest.mark.slow
def test_a_drift_that_turns_in_the_plane():
    """A trap with a rotation: no potential has such a force."""
    matrix = np.array([[-RATE, -1.5], [1.5, -RATE]])
    times, seen = film(
        lambda time, x: x @ matrix.T,
        lambda x: DIFFUSION,
        np.zeros((16, 2)),
        10 * np.arange(1, 401),
        exposed=5,
        error=0.03,
    )
    data = tracks(times, seen)
    axes, seen = (KernelAxis(0), KernelAxis(1)), fitting.LearnedObservation()
    fit = path_of(data, *axes, across=4, observation=seen)
    diffusion = number(fit)
    assert abs(diffusion.value - DIFFUSION) < 3 * diffusion.sd
    angles = np.linspace(0, TURN, 16, endpoint=False)
    points = 0.7 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    miss = drift(fit, points) - points @ matrix.T
    assert np.mean(np.abs(miss) < 2.5 * fit.posterior.force_sd(points)) > 0.8
    assert np.linalg.norm(miss) < 0.4 * np.linalg.norm(points @ matrix.T)


def test_the_warp_begins_where_steps_are_short():
    """Kernels are finest at the wall: the end where the bead hardly moves."""
    heights, upwards = [0.5], True
    for _ in range(4000):
        upwards = heights[-1] < (2.5 if upwards else 0.51)
        heights.append(heights[-1] * (1.02 if upwards else 1 / 1.02))
    for sign in (1.0, -1.0):
        path = sign * np.array(heights)[None, :, None]
        warp = fitting.warp_at_slow_end(tracks(np.arange(4001.0), path), 0)
        assert warp.origin == pytest.approx(sign * 0.5, abs=0.02)
        assert warp.scale == pytest.approx(0.02 * 0.5, rel=0.1)
    few = tracks(np.arange(20.0), np.zeros((2, 20, 1)))
    with pytest.raises(InputError, match="expected 100 or more steps, got 38"):
        fitting.warp_at_slow_end(few, 0)


def test_a_known_diffusion_is_the_noise_of_its_increments():
    """Those of a path, over the root of their interval, have the variance 2 D."""
    rng, interval, count = np.random.default_rng(5), 0.1, 1000
    steps = np.sqrt(2 * DIFFUSION * interval) * rng.normal(size=(count, 1))
    path = np.concatenate([np.zeros((1, 1)), np.cumsum(steps, axis=0)])
    data = tracks(interval * np.arange(count + 1.0), path[None])
    model = OverdampedSwimmer(
        ZeroForce(), fitting.kernel_environment(KernelForce, data, dim=1), 1.0
    )
    fit = fitting.fit_langevin(model, data, diffusion=DIFFUSION)
    assert fit.hyperparameters.noise == pytest.approx(np.sqrt(2 * DIFFUSION))
