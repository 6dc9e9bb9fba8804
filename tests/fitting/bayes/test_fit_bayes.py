import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.fitted_runs import crossing_system, crossings
from tests.fitting.problems import STATES, beginning, observing

from pinav.dynamics import FixedStep, rollout
from pinav.errors import FitError, InputError
from pinav.evaluation import rollout_bands
from pinav.evaluation.force_fields import exact_forces, force_error_at_samples
from pinav.fitting import Outcome, fit_bayes, kernel_environment
from pinav.fitting.bayes.neural import FitSpecification
from pinav.fitting.rugged.pieces import fit_pieces
from pinav.fitting.structure.fits import Fits
from pinav.fitting.structure.trace import Trace
from pinav.forces import AbstractForce, GaussianBarrier, KernelForce, KernelPotential
from pinav.forces.priors import WeightPrior
from pinav.systems import Observation
from pinav.trajectories import Trajectories, simulate

NOISE = 0.02


@pytest.fixture(scope="module")
def scenario():
    """Four of the crossings, for their first six time units."""
    return crossing_system(4, 61)


@pytest.fixture(scope="module")
def exact():
    """The same without noise."""
    return simulate(crossing_system(4, 61, observation=Observation(0.0)))


@pytest.fixture(scope="module")
def data():
    return crossings(61, key=1)


@pytest.fixture(scope="module")
def untrained(scenario, data):
    environment = kernel_environment(KernelPotential, data)
    return scenario.swimmer.with_environment(environment)


@pytest.fixture(scope="module")
def fitted(untrained, data):
    return fit_bayes(untrained, data)


def error(fit, scenario, data):
    return force_error_at_samples(fit.model.environment, scenario.environment, data)


def test_a_kernel_potential_learns_the_force_from_noisy_crossings(
    fitted, scenario, data
):
    assert fitted.outcome is Outcome.CONVERGED
    assert fitted.iterations <= 8
    assert error(fitted, scenario, data) < 0.03
    assert fitted.hyperparameters.noise == pytest.approx(NOISE, rel=0.1)


def test_the_smoothed_states_are_a_rollout_nearer_to_the_truth(fitted, data, exact):
    starts = [states[0] for states in fitted.states]
    solve = eqx.filter_jit(FixedStep().solve)
    rolled = [solve(fitted.model, y0, data.times[0])[0] for y0 in starts]
    np.testing.assert_allclose(fitted.states, rolled, atol=1e-4)
    smoothed = np.sqrt(np.mean((fitted.states - exact.states) ** 2))
    assert smoothed < 0.5 * NOISE


def test_the_band_covers_the_true_force(fitted, scenario, data):
    points = data.states[..., :2].reshape(-1, 2)
    miss = exact_forces(fitted.model.environment, points) - exact_forces(
        scenario.environment, points
    )
    inside = np.abs(miss) < 1.96 * fitted.posterior.force_sd(points)
    assert inside.mean() > 0.85


def test_far_from_the_data_the_force_is_as_uncertain_as_it_is_large_among_them(
    fitted, data
):
    visited = exact_forces(fitted.model.environment, data.seen_positions)
    size = np.sqrt(np.mean(visited**2))
    sd = fitted.posterior.force_sd(np.array([[100.0, 100.0]]))
    assert np.all((0.5 * size < sd) & (sd < 2 * size))


@pytest.mark.slow
def test_samples_spread_as_the_posterior_says(fitted):
    points = np.array([[4.0, 5.0], [6.0, 7.0]])
    models = fitted.posterior.samples(400, key=jax.random.key(0))
    draws = np.stack([exact_forces(model.environment, points) for model in models])
    sd = fitted.posterior.force_sd(points)
    np.testing.assert_allclose(draws.std(axis=0), sd, rtol=0.15)
    mean = exact_forces(fitted.model.environment, points)
    assert np.all(np.abs(draws.mean(axis=0) - mean) < 0.25 * sd)


@pytest.mark.slow
def test_the_band_of_a_rollout_is_the_spread_of_sampled_rollouts(fitted, data):
    shown = beginning(data, 21)
    bands = rollout_bands(fitted.posterior, shown, noise=0.01)
    np.testing.assert_allclose(bands.sd[0, 0], 0.01)
    fixed = rollout_bands(fitted.posterior, shown)
    assert np.all(fixed.sd <= bands.sd)
    solve = eqx.filter_jit(rollout)
    models = fitted.posterior.samples(200, key=jax.random.key(1))
    start, times = shown.states[0, 0], shown.times[0]
    draws = [solve(m, start, times, solver=FixedStep()).ys[-1] for m in models]
    np.testing.assert_allclose(np.std(draws, axis=0), fixed.sd[0, -1], rtol=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("missing", [[2, 3], [3]], ids=["velocities", "vy"])
def test_positions_alone_suffice(untrained, scenario, data, missing):
    observed = data.observed.copy()
    observed[..., missing] = False
    found = fit_bayes(untrained, observing(data, observed))
    assert found.outcome is Outcome.CONVERGED
    assert error(found, scenario, data) < 0.12
    assert found.hyperparameters.noise == pytest.approx(NOISE, rel=0.1)


@pytest.mark.slow
def test_damping_is_learned_within_its_interval(untrained, data):
    start = eqx.tree_at(lambda m: m.drag.damping, untrained, 0.1)
    found = fit_bayes(start, data, learn=lambda m: m.drag.damping)
    (damping,) = found.constants.values()
    assert list(found.constants) == ["drag.damping"]
    assert abs(damping.value - 0.36) < 2.5 * damping.sd
    assert damping.sd < 0.01
    assert float(found.model.drag.damping) == pytest.approx(damping.value)


@pytest.mark.slow
def test_holes_and_trajectories_of_different_lengths_are_no_obstacle(
    untrained, scenario, data
):
    rng = np.random.default_rng(0)
    lengths = [61, 50, 61, 40]
    keep = [np.sort(rng.permutation(n)[: n - 6]) for n in lengths]
    keep[0] = np.arange(61)
    holes = Trajectories.from_arrays(
        [data.times[i][rows] for i, rows in enumerate(keep)],
        [data.states[i][rows] for i, rows in enumerate(keep)],
        channels=data.channels,
        observed=[rng.uniform(size=(len(rows), 4)) > 0.2 for rows in keep],
    )
    found = fit_bayes(untrained, holes, noise=NOISE)
    assert found.outcome is Outcome.CONVERGED
    assert found.hyperparameters.noise == NOISE
    assert error(found, scenario, data) < 0.05


@pytest.mark.slow
def test_data_without_noise_converge_to_little_noise(untrained, scenario, exact):
    found = fit_bayes(untrained, exact, throw=False)
    assert found.outcome is Outcome.CONVERGED
    assert found.hyperparameters.noise < 1e-3
    assert error(found, scenario, exact) < 1e-3


@pytest.mark.slow
def test_iterations_that_run_out_are_a_stall(untrained, data):
    with pytest.raises(FitError, match="stalled: its iterations ran out"):
        fit_bayes(untrained, data, max_iterations=1)
    found = fit_bayes(untrained, data, max_iterations=1, throw=False)
    assert found.outcome is Outcome.STALLED
    assert np.all(np.isfinite(found.posterior.mean))


@pytest.mark.slow
def test_pieces_of_trajectories_tell_the_force_of_a_fit_that_diverged(
    untrained, fitted, scenario, data
):
    """A right model leaves the same noise in halves, which are long enough then."""
    specification = FitSpecification(untrained, data, lambda _: (), None, FixedStep())
    diverged = dataclasses.replace(fitted, outcome=Outcome.DIVERGED)
    with jax.enable_x64():
        fits = Fits(specification, 20, None, throw=False, trace=Trace())
        pieces = fit_pieces(fits, diverged)
    assert pieces.outcome is Outcome.MISFIT
    assert pieces.hyperparameters.noise == pytest.approx(NOISE, rel=0.1)
    assert error(pieces, scenario, data) < 0.1
    assert pieces.states.shape == data.states.shape
    assert np.std((pieces.states - data.states)[data.observed]) < 1.1 * NOISE


def test_rates_that_are_not_finite_are_a_divergence(untrained, data):
    broken = eqx.tree_at(lambda m: m.drag.damping, untrained, jnp.inf)
    with pytest.raises(FitError, match="diverged at once: .* not finite"):
        fit_bayes(broken, data, throw=False)


class RootDrag(AbstractForce):
    """Drag whose constant must not become negative."""

    square: jax.Array

    def __call__(self, t, x, v):
        return -jnp.sqrt(self.square) * v


@pytest.mark.slow
def test_a_step_to_where_nothing_is_finite_is_a_divergence(untrained, data):
    """From 1 the tangent of the root reaches 0.36 at -0.28."""
    model = eqx.tree_at(lambda m: m.drag, untrained, RootDrag(jnp.asarray(1.0)))
    with pytest.raises(FitError, match="the fit diverged: the states depart from"):
        fit_bayes(model, data, learn=lambda m: m.drag.square)
    found = fit_bayes(model, data, learn=lambda m: m.drag.square, throw=False)
    assert found.outcome is Outcome.DIVERGED
    assert found.iterations == 1
    assert found.constants["drag.square"].value < 0


SINGULAR = {
    "only their product matters": (0.2, lambda p: (p.gain, p.field.amplitude)),
    "it does nothing": (0.0, lambda p: p.axis),
}


@pytest.mark.parametrize(("gain", "learn"), SINGULAR.values(), ids=SINGULAR)
def test_constants_that_data_cannot_tell_are_singular(untrained, data, gain, learn):
    model = eqx.tree_at(lambda m: m.propulsion.gain, untrained, gain)
    with pytest.raises(FitError, match="do not determine the learned constants"):
        fit_bayes(model, data, learn=lambda m: learn(m.propulsion))


def test_what_was_observed_too_little_is_refused(untrained, data):
    observed = data.observed.copy()
    observed[2, :, 0] = False
    with pytest.raises(InputError, match="channel 'x' of trajectory 2: 0 obs"):
        fit_bayes(untrained, observing(data, observed))
    observed[..., 0] = False
    hidden = observing(data, observed)
    with pytest.raises(InputError, match="channel 'x' of trajectory 0: 0 obs"):
        fit_bayes(untrained, hidden)
    still = Trajectories.from_arrays([0.0, 1.0], np.zeros((2, 4)), channels=STATES)
    for seen in (hidden, still):
        with pytest.raises(InputError, match="two or more different observed positio"):
            kernel_environment(KernelPotential, seen)
    observed = np.zeros_like(data.observed)
    observed[:, [0, 30], :2] = True
    with pytest.raises(InputError, match="channel 'vx'|16 observations are no more"):
        fit_bayes(untrained, observing(data, observed))


def test_other_mistakes_are_named(untrained, data):
    for noise in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="noise: expected a finite number > 0"):
            fit_bayes(untrained, data, noise=noise)
    with pytest.raises(InputError, match="max_iterations: expected >= 1, got 0"):
        fit_bayes(untrained, data, max_iterations=0)
    with pytest.raises(InputError, match="environment.width belongs to the environ"):
        fit_bayes(untrained, data, learn=lambda m: m.environment.width)
    with pytest.raises(InputError, match="expected 4 channels"):
        fit_bayes(untrained, data.only(("x", "vx")))


@pytest.mark.parametrize("kind", [KernelForce, KernelPotential])
def test_an_environment_made_from_data_surrounds_them(data, kind):
    made = kernel_environment(kind, data)
    positions = data.states[..., :2].reshape(-1, 2)
    offsets = positions[:, None] - np.asarray(made.centers)
    distance = np.linalg.norm(offsets, axis=-1)
    assert distance.min(axis=1).max() < made.width
    assert distance.min(axis=0).max() < 4 * made.width
    assert not np.any(exact_forces(made, positions))


def test_a_wide_envelope_is_no_envelope_and_a_narrow_one_fades():
    axis = np.arange(-10.0, 11.0)[:, None]
    prior = WeightPrior(axis, 2.0)
    stationary = np.exp(-0.5 * ((axis - axis.T) / 3.0) ** 2)
    wide = prior.covariance(np.array([np.log(1.5), np.log(1e4), 0.0]))
    np.testing.assert_allclose(wide, stationary, rtol=1e-5)
    narrow = prior.covariance(np.array([np.log(1.5), 0.0, 1.0]))
    expected = np.exp(-(((axis[:, 0] - 2.0) / 2.0) ** 2))
    np.testing.assert_allclose(np.diag(narrow), expected)


@pytest.mark.slow
def test_two_obstacles_are_learned_with_a_wide_envelope(scenario):
    """Where the field does not fade away from one place the evidence notices."""
    hill, pit = (
        GaussianBarrier(4.0, [2.0, 3.0], 1.5),
        GaussianBarrier(-3.0, [8, 6], 2.0),
    )
    two = scenario.with_truth(hill + pit)
    seen = simulate(two, key=jax.random.key(3))
    kernels = kernel_environment(KernelPotential, seen)
    found = fit_bayes(scenario.swimmer.with_environment(kernels), seen)
    assert found.outcome is Outcome.CONVERGED
    assert error(found, two, seen) < 0.1
    assert found.hyperparameters.shape[1] > 0.5
