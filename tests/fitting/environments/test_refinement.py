"""Kernels are laid anew where the evidence finds them too coarse, and only there."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.fitting.problems import Drifter
from tests.refusals import refusals

from pinav.dynamics import FixedStep, rollout
from pinav.evaluation.force_fields import force_error_at_samples
from pinav.fitting import (
    KernelGrid,
    Outcome,
    Refinement,
    changing_environment,
    fit_bayes,
    kernel_environment,
    neural_environment,
)
from pinav.fitting.environments.kernels import MOST_WEIGHTS, OFTEN, num_weights
from pinav.fitting.environments.refinement import WORTH
from pinav.forces import (
    KernelForce,
    KernelMixture,
    KernelPotential,
    KernelStream,
    NeuralForce,
    ZeroForce,
)
from pinav.trajectories import Trajectories

NOISE = 0.003
LINE, PLANE = ("x",), ("x", "y")
STARTS = (0.0, 0.2)


def bumps(width):
    """A row of bumps of alternating sign, four widths apart."""
    centers = np.arange(0.0, 4.0, 3 * width)[:, None]
    weights = 0.5 * width * (-1.0) ** np.arange(len(centers))
    return KernelPotential(jnp.asarray(weights), jnp.asarray(centers), width)


def drifts(force):
    """Noisy drifts over the bumps, on a line."""
    times, rng = np.linspace(0.0, 4.0, 161), np.random.default_rng(0)
    truth = Drifter(jnp.array([1.0]), force)
    solver = FixedStep(substeps=4)
    states = [rollout(truth, np.array([y0]), times, solver=solver).ys for y0 in STARTS]
    noisy = [np.asarray(y) + NOISE * rng.normal(size=y.shape) for y in states]
    return truth, Trajectories.from_arrays(times, noisy, channels=LINE)


FEW = KernelGrid(across=8)
"""Farther apart than the bumps."""


def untrained(truth, data, grid=FEW):
    return truth.with_environment(
        kernel_environment(KernelPotential, data, grid, dim=1)
    )


def error(fit, truth, data):
    return force_error_at_samples(fit.model.environment, truth.environment, data)


@pytest.fixture(scope="module")
def rough():
    return drifts(bumps(0.12))


@pytest.fixture(scope="module")
def refined(rough):
    at_once = Refinement(factor=3.5)
    return fit_bayes(untrained(*rough), rough[1], refine=at_once)


@pytest.mark.slow
def test_narrow_bumps_get_finer_kernels(rough, refined):
    truth, data = rough
    coarse = fit_bayes(untrained(*rough), data, refine=None, throw=False)
    assert coarse.model.environment.width > 2 * refined.model.environment.width
    assert refined.outcome is Outcome.CONVERGED
    environment = refined.model.environment
    (length_scale,) = environment.length_scales(refined.hyperparameters.shape)
    assert length_scale >= 1
    assert error(refined, truth, data) < 0.2 * error(coarse, truth, data)
    better = refined.hyperparameters.log_evidence - coarse.hyperparameters.log_evidence
    assert better > 10


@pytest.mark.slow
def test_the_result_is_that_of_a_fit_on_the_finer_grid(rough, refined):
    environment = refined.model.environment
    across = round(float(np.ptp(rough[1].states)) / environment.width)
    direct = fit_bayes(untrained(*rough, KernelGrid(across=across)), rough[1])
    np.testing.assert_allclose(direct.posterior.mean, refined.posterior.mean)
    assert direct.iterations == refined.iterations


@pytest.mark.slow
def test_a_network_is_taught_by_kernels_as_fine_as_asked(rough, refined):
    truth, data = rough
    network = neural_environment(
        NeuralForce, data, key=jax.random.key(0), width=4, depth=1, dim=1
    )
    found = fit_bayes(
        truth.with_environment(network),
        data,
        refine=Refinement(factor=2.0),
        max_iterations=1,
        throw=False,
    )
    process = found.linear.weights.process
    begun = kernel_environment(KernelForce, data, dim=1)
    assert process.kernels.width < begun.width / 1.8
    noise = refined.hyperparameters.noise
    assert process.chosen.noise == pytest.approx(noise, rel=0.05)


@pytest.mark.slow
def test_wide_bumps_keep_their_kernels():
    truth, data = drifts(bumps(1.0))
    model = untrained(truth, data)
    found = fit_bayes(model, data)
    kept = fit_bayes(model, data, refine=None)
    np.testing.assert_array_equal(found.posterior.mean, kept.posterior.mean)


@pytest.mark.slow
def test_without_room_the_outcome_says_so(rough):
    model = untrained(*rough)
    count = model.environment.weights.size
    found = fit_bayes(
        model, rough[1], refine=Refinement(max_weights=count), throw=False
    )
    assert found.outcome in (Outcome.UNDER_RESOLVED, Outcome.STALLED)
    assert found.model.environment.weights.size == count


@pytest.fixture(scope="module")
def walk():
    """Positions in the plane, of which the second sample is unseen."""
    states = np.random.default_rng(1).uniform(0.0, 3.0, (1, 12, 2))
    observed = np.ones(states.shape, bool)
    states[0, 1], observed[0, 1] = 1e3, False
    return Trajectories.from_arrays(
        np.arange(12.0), list(states), observed=list(observed), channels=PLANE
    )


@pytest.mark.parametrize(
    "kind", [KernelForce, KernelPotential, KernelStream, KernelMixture]
)
def test_finer_kernels_are_of_the_same_kind_and_width_of_their_spacing(walk, kind):
    made = kernel_environment(kind, walk, dim=2)
    finer = Refinement(factor=2.0, max_weights=10_000).finer(made, walk)
    assert type(finer) is kind
    both = [e.gradient if kind is KernelMixture else e for e in (made, finer)]
    assert both[1].width == pytest.approx(both[0].width / 2)
    spacing = np.diff(np.unique(np.asarray(both[1].centers)[:, 0]))
    np.testing.assert_allclose(spacing, both[1].width, rtol=1e-6)
    as_many = Refinement(max_weights=num_weights(made))
    assert as_many.finer(made, walk) is None


def test_a_change_in_time_stays_as_it_is(walk):
    made = changing_environment(walk, dim=2)
    finer = Refinement(max_weights=10_000).finer(made, walk)
    assert finer is not None
    assert finer.change is made.change
    assert finer.static.width < made.static.width


@pytest.mark.slow
def test_in_space_a_finer_grid_has_at_most_so_many_kernels():
    """Where half of the spacing has no room, what has room, unless it is no finer."""
    places = np.random.default_rng(2).uniform(0.0, 3.0, (1, 400, 3))
    crowd = Trajectories.from_arrays(
        np.arange(400.0), list(places), channels=("x", "y", "z")
    )
    made = kernel_environment(KernelPotential, crowd, dim=3)
    finer = Refinement().finer(made, crowd)
    assert finer is not None
    assert len(made.centers) < len(finer.centers) <= OFTEN * MOST_WEIGHTS
    assert finer.width < made.width / WORTH
    assert Refinement().finer(finer, crowd) is None


def test_only_parts_that_have_a_say_are_asked(walk):
    mixture = kernel_environment(KernelMixture, walk, dim=2)
    first, second = np.log([0.5, 9.0, 1.0, 1.0]), np.log([3.0, 9.0, 1.0, 1.0])
    for one, other, ratio, asked in (
        (first, second, 0.0, True),
        (second, first, 0.0, True),
        (second, second, 0.0, False),
        (first, second, 7.0, False),
        (second, first, -7.0, False),
    ):
        shape = np.concatenate([one, other, [ratio]])
        assert Refinement().is_needed(mixture, shape) == asked
    changing = changing_environment(walk, dim=2)
    for one, asked in ((second, False), (first, True)):
        shape = np.concatenate([one, first, [1.0, 0.0]])
        assert Refinement().is_needed(changing, shape) == asked
    assert not Refinement().is_needed(ZeroForce(), np.zeros(0)), "it has no kernels"


test_bad_numbers_are_refused = refusals(
    (lambda: Refinement(factor=1.0), "Refinement.factor: expected > 1, got 1.0"),
    (lambda: Refinement(shortest=0.0), "Refinement.shortest: expected > 0, got 0.0"),
    (lambda: Refinement(max_weights=0), "Refinement.max_weights: expected > 0, got 0"),
)
