import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares
from tests.fitted_runs import crossing_system

from pinav import evaluation
from pinav.dynamics import FixedStep, paper_black_box, rollout
from pinav.errors import InputError
from pinav.fitting import Outcome
from pinav.systems import Observation
from pinav.trajectories import Trajectories, simulate


@pytest.fixture(scope="module")
def clean():
    short = crossing_system(3, 41, observation=Observation())
    return short, simulate(short)


def observed_positions(data, noise=0.0):
    random = np.random.default_rng(1)
    states = data.states + noise * random.standard_normal(data.states.shape)
    observed = np.zeros(data.states.shape, bool)
    observed[:, ::2, :2] = True
    return Trajectories.from_arrays(
        list(data.times), list(states), channels=data.channels, observed=list(observed)
    )


def test_positions_of_every_other_sample_give_the_true_start(clean):
    scenario, data = clean
    found = evaluation.estimate_starts(scenario.truth, observed_positions(data))
    assert found.outcomes == (Outcome.CONVERGED,) * 3
    np.testing.assert_allclose(found.states, scenario.starts, atol=1e-6)
    ys, _ = evaluation.predict(scenario.truth, data, starts=found.states)
    np.testing.assert_allclose(ys, data.states, atol=1e-5)


def test_a_noisy_start_is_that_of_least_squares(clean):
    scenario, data = clean
    noisy = observed_positions(data, 0.05)
    found = evaluation.estimate_starts(scenario.truth, noisy, count=12).states[1]
    seen = noisy.observed[1, :12]
    solve = eqx.filter_jit(rollout)

    def residuals(y0):
        ys = solve(
            scenario.truth,
            jnp.asarray(y0),
            jnp.asarray(data.times[1, :12]),
            solver=FixedStep(substeps=4),
        ).ys
        return (np.asarray(ys) - noisy.states[1, :12])[seen]

    best = least_squares(residuals, np.asarray(scenario.starts[1]), xtol=1e-12)
    np.testing.assert_allclose(found, best.x, atol=1e-5)


def test_a_model_that_is_not_finite_gives_no_start_and_no_rollout(clean):
    scenario, data = clean
    noisy = observed_positions(data, 0.05)
    box = eqx.tree_at(
        lambda m: m.network.layers[-1].bias,
        paper_black_box(jax.random.key(0)),
        jnp.full(4, jnp.nan),
    )
    found = evaluation.estimate_starts(box, noisy)
    assert found.outcomes == (Outcome.DIVERGED,) * 3
    assert np.isnan(found.states).all()
    ys, outcomes = evaluation.predict(scenario.truth, noisy, starts=found.states)
    assert np.isnan(ys).all()
    assert all(outcomes)


def test_the_first_samples_are_those_that_are_taken_away(clean):
    data = clean[1]
    assert evaluation.first_samples(data, 5).times.shape == (3, 5)
    rest = evaluation.without_first(data, 5)
    assert not rest.observed[:, :5].any()
    assert rest.observed[:, 5:].all()
    with pytest.raises(InputError, match="expected more than 41 samples, from which"):
        evaluation.first_samples(data, 41)
    with pytest.raises(InputError, match="starts count: expected 2 or more samples"):
        evaluation.first_samples(data, 1)
