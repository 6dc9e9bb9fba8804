import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.fitting.problems import follow

from pinav import fitting
from pinav.dynamics import FixedStep, Swimmer
from pinav.fitting.matching.recipes import _is_worse, _join, _shuffle
from pinav.fitting.matching.state import Fit
from pinav.forces import (
    GaussianBarrier,
    LinearDrag,
    NeuralForce,
    PositionFeatures,
    ZeroForce,
    tanh_network,
)

TRUTH = Swimmer(ZeroForce(), LinearDrag(0.5), GaussianBarrier(2.0, [1.0, 0.2], 0.8))
START = eqx.tree_at(lambda s: s.environment.height, TRUTH, 1.0)


@pytest.fixture(scope="module")
def data():
    return follow(TRUTH, [[-1.0, 0.1, 1.5, 0.1]], [np.arange(0.0, 2.0, 0.1)])


def ended(outcome, *losses):
    return Fit(TRUTH, START, np.asarray(losses), (("Adam", 0),), outcome)


def test_the_better_attempt_is_kept_with_the_losses_of_both():
    first = ended(fitting.Outcome.STALLED, 9.0, 1.0)
    worse, better = (ended(fitting.Outcome.MISFIT, 9.0, x) for x in (2.0, 0.5))
    kept = _join(first, worse, worse, keep=True)
    assert kept.outcome is fitting.Outcome.STALLED
    assert kept.losses.tolist() == [9.0, 1.0, 9.0, 1.0]
    assert kept.phases == (("Adam", 0), ("Adam", 2))
    after = _join(first, better, better, keep=False)
    assert (after.outcome, after.losses[-1]) == (fitting.Outcome.MISFIT, 0.5)
    lost = ended(fitting.Outcome.DIVERGED, 9.0, np.nan)
    for one, other in ((worse, first), (first, better), (lost, worse)):
        assert _is_worse(one, other)
        assert not _is_worse(other, one)


def test_what_converged_waits_for_the_others():
    other = ended(fitting.Outcome.STALLED, 9.0, 8.0, 7.0)
    kept = _join(ended(fitting.Outcome.CONVERGED, 9.0, 1.0), None, other, keep=False)
    assert kept.losses.tolist() == [9.0, 1.0, 1.0, 1.0, 1.0]


def test_a_later_attempt_begins_with_another_network_of_the_same_weights():
    network = tanh_network(2, 2, width=8, depth=1, key=jax.random.key(0))
    model = TRUTH.with_environment(
        NeuralForce(network, PositionFeatures((0.0, 0.0), (1.0, 1.0)))
    )
    shuffled = _shuffle(model, lambda m: m.environment.parameters, 0)
    for before, after in zip(
        jax.tree.leaves(model), jax.tree.leaves(shuffled), strict=True
    ):
        assert np.array_equal(before, after) == (np.ndim(before) < 2)
        np.testing.assert_array_equal(np.sort(before, None), np.sort(after, None))
    same = _shuffle(TRUTH, lambda m: m.environment, 0)
    assert jax.tree.all(jax.tree.map(np.array_equal, same, TRUTH))


@pytest.mark.slow
def test_a_fit_that_ended_well_has_one_attempt(data):
    options = {"trainable": lambda m: m.environment.height, "dtype": jnp.float64}
    recipes = ((fitting.Adam(1e-2, 2),), (fitting.Adam(1e-2, 3),))
    (fit,) = fitting.fit_in_turns([START], data, recipes, **options)
    assert len(fit.losses) == 3


@pytest.mark.slow
def test_a_fit_that_failed_is_tried_again(data):
    at = jnp.asarray(data.states[0])
    rates = np.asarray(jnp.stack([TRUTH(0.0, y) for y in at]))
    targets = fitting.Rates(data.times[0], data.states[0], rates)
    hasty = fitting.curriculum(data, max_steps=1)[:1]
    recipes = (hasty, (fitting.RateMatching(targets), *fitting.curriculum(data)))
    options = {"trainable": lambda m: m.environment, "dtype": jnp.float64}
    (fit,) = fitting.fit_in_turns([START], data, recipes, **options)
    assert fit.outcome is fitting.Outcome.CONVERGED
    assert fit.model.environment.height == pytest.approx(2.0, rel=1e-4)
    assert [name for name, _ in fit.phases][:2] == ["L = 1", "Rates"]


FINER = {
    "trainable": lambda m: m.environment.height,
    "objective": fitting.TrajectoryLoss(FixedStep(substeps=8)),
    "dtype": jnp.float64,
}


def converged_beside_stalled(model):
    """Two fits, of which the first ended well at a model."""
    good = Fit(model, START, np.array([9.0, 1e-12]), (), fitting.Outcome.CONVERGED)
    return [good, ended(fitting.Outcome.STALLED, 9.0, 8.0)]


def test_a_fit_that_follows_the_data_by_finer_steps_is_left_alone(data):
    fits = converged_beside_stalled(TRUTH)
    after = fitting.fit_with_finer_steps(
        fits, data, fitting.curriculum(data)[-1:], **FINER
    )
    assert all(one is other for one, other in zip(after, fits, strict=True))


@pytest.mark.slow
def test_a_fit_that_only_its_own_steps_follow_goes_on_by_finer_ones(data):
    near = eqx.tree_at(lambda s: s.environment.height, TRUTH, 1.99)
    after, other = fitting.fit_with_finer_steps(
        converged_beside_stalled(near), data, fitting.curriculum(data)[-1:], **FINER
    )
    assert after.model.environment.height == pytest.approx(2.0, rel=1e-6)
    assert after.initial_model is START
    assert other.model is TRUTH
    assert len(after.losses) == len(other.losses) > 2
