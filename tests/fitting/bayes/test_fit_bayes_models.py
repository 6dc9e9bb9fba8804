"""`fit_bayes` of parametric environments and of dynamics of first order."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.fitted_runs import crossing_system, crossings
from tests.fitting.problems import Drifter, observing

from pinav.dynamics import AbstractDynamics, FixedStep, rollout
from pinav.errors import InputError
from pinav.evaluation.force_fields import force_error_at_samples
from pinav.fitting import Outcome, fit_bayes, kernel_environment, model_evidence
from pinav.forces import GaussianBarrier, KernelForce, KernelPotential
from pinav.trajectories import Trajectories

pytestmark = pytest.mark.slow

NOISE = 0.02
BARRIER = GaussianBarrier(2.0, [1.0, 0.5], 1.2)


@pytest.fixture(scope="module")
def drifts():
    """Six noisy drifts past a barrier: positions are the whole state."""
    truth = Drifter(jnp.array([1.0, 0.3]), BARRIER)
    times, rng = np.linspace(0.0, 3.0, 31), np.random.default_rng(0)
    starts = np.stack([np.full(6, -1.0), np.linspace(-2.0, 1.5, 6)], axis=1)
    solver = FixedStep(substeps=4)
    states = [rollout(truth, y0, times, solver=solver).ys for y0 in starts]
    noisy = [np.asarray(y) + NOISE * rng.normal(size=y.shape) for y in states]
    data = Trajectories.from_arrays(times, noisy, channels=("x", "y"))
    return truth, data


def guess(model):
    """The same dynamics with a wrong barrier."""
    offset = np.asarray(model.environment.center) + np.array([0.5, -0.4])
    wrong = GaussianBarrier(
        0.7 * model.environment.height, offset, 1.2 * model.environment.width
    )
    return model.with_environment(wrong)


def values(barrier):
    return np.array([barrier.height, *barrier.center, barrier.width])


@pytest.fixture(scope="module", params=["second order", "first order"])
def parametric(request, drifts):
    if request.param == "first order":
        truth, data = drifts
    else:
        truth, data = crossing_system(3, 51).truth, crossings(51, count=3, key=1)
    return truth, data, fit_bayes(guess(truth), data, learn=lambda m: m.environment)


def test_a_parametric_environment_is_found_within_its_intervals(parametric):
    truth, _, found = parametric
    assert found.outcome is Outcome.CONVERGED
    assert list(found.constants) == [
        "environment.height",
        "environment.center[0]",
        "environment.center[1]",
        "environment.width",
    ]
    sd = np.array([estimate.sd for estimate in found.constants.values()])
    learned = values(found.model.environment)
    assert np.all(np.abs(learned - values(truth.environment)) < 4 * sd)
    assert np.all(sd < 0.1 * np.abs(learned))
    assert found.hyperparameters.noise == pytest.approx(NOISE, rel=0.15)
    assert found.hyperparameters.shape.size == 0


def test_the_intervals_are_those_of_least_squares_on_rollouts(parametric):
    """Starts and parameters together, by an independent Jacobian."""
    truth, data, found = parametric
    times, solver = jnp.asarray(data.times[0]), FixedStep()

    def rolled(parameters, starts):
        force = GaussianBarrier(parameters[0], parameters[1:3], parameters[3])
        model = truth.with_environment(force)
        return jax.vmap(lambda y0: solver.solve(model, y0, times)[0])(starts).ravel()

    best = jnp.asarray(values(found.model.environment))
    starts = jnp.asarray(found.states[:, 0])
    left, right = jax.jacfwd(rolled, (0, 1))(best, starts)
    rows = np.concatenate([left, right.reshape(len(left), -1)], axis=1)
    residuals = np.asarray(rolled(best, starts)) - data.states.ravel()
    variance = residuals @ residuals / (len(rows) - rows.shape[1])
    expected = np.sqrt(np.diag(variance * np.linalg.inv(rows.T @ rows)))[:4]
    sd = np.array([estimate.sd for estimate in found.constants.values()])
    np.testing.assert_allclose(sd, expected, rtol=0.02)
    np.testing.assert_allclose(rows.T @ residuals, 0.0, atol=2.0 * NOISE)


def test_a_known_model_has_the_evidence_of_its_noise_and_starts(drifts):
    """Without a force each path is its start plus a line, and starts are means."""
    truth, data = drifts
    known = truth.without_environment()
    found = fit_bayes(known, data, learn=None)
    assert found.outcome is Outcome.CONVERGED
    assert found.posterior.mean.size == 0
    assert not found.constants
    lines = data.times[..., None] * np.asarray(truth.drift)
    starts = (data.states - lines).mean(axis=1, keepdims=True)
    np.testing.assert_allclose(found.states, starts + lines, atol=1e-9)
    residuals = data.states - found.states
    free = residuals.size - starts.size
    noise = np.sqrt(np.sum(residuals**2) / free)
    assert found.hyperparameters.noise == pytest.approx(noise)
    samples = data.states[0].size
    evidence = model_evidence(found.linear, found.hyperparameters)
    assert evidence.best == pytest.approx(
        -0.5 * residuals.size * np.log(2 * np.pi * noise**2)
        - 0.5 * np.sum(residuals**2) / noise**2
        - 0.5 * starts.size * np.log(samples)
    )


def test_known_kernels_stay_as_they_are(drifts):
    truth, data = drifts
    kernels = kernel_environment(KernelPotential, data, dim=2)
    known = truth.with_environment(kernels)
    found = fit_bayes(known, data, learn=None)
    nothing = truth.without_environment()
    expected = fit_bayes(nothing, data, learn=None)  # untrained kernels are no force
    np.testing.assert_allclose(found.states, expected.states, atol=1e-9)
    assert found.model.environment.weights.shape == kernels.weights.shape


@pytest.mark.parametrize("kind", [KernelForce, KernelPotential])
def test_kernels_are_fitted_to_dynamics_of_first_order(drifts, kind):
    truth, data = drifts
    found = fit_bayes(truth.with_environment(kernel_environment(kind, data)), data)
    assert found.outcome is Outcome.CONVERGED
    assert found.hyperparameters.noise == pytest.approx(NOISE, rel=0.15)
    assert force_error_at_samples(found.model.environment, BARRIER, data) < 0.1


def test_positions_are_no_velocities_of_each_other(drifts):
    truth, data = drifts
    half = observing(data, np.broadcast_to([True, False], data.states.shape))
    with pytest.raises(InputError, match="channel 'y' of trajectory 0: 0 observ"):
        fit_bayes(truth, half, learn=lambda m: m.environment)


def test_models_with_nothing_to_learn_are_refused(drifts):
    truth, data = drifts
    with pytest.raises(InputError, match="learn: ZeroForce has no weights"):
        fit_bayes(truth.without_environment(), data)
    with pytest.raises(InputError, match="force called environment, got EmptyDyn"):
        fit_bayes(EmptyDynamics(), data)
    three = Trajectories.from_arrays([0.0, 1.0], np.eye(2, 3), channels=("x", "y", "z"))
    kernels = kernel_environment(KernelPotential, data, dim=2)
    with pytest.raises(InputError, match="expected 2 or 4 channels, got x, y, z"):
        fit_bayes(truth.with_environment(kernels), three)
    with pytest.raises(InputError, match="kernel_environment dim: expected 1 to 2"):
        kernel_environment(KernelPotential, data, dim=3)


class EmptyDynamics(AbstractDynamics):
    """Nothing moves, nothing is unknown."""

    def __call__(self, t, y):
        return jnp.zeros_like(y)
