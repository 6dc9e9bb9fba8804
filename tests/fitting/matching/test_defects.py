import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from tests.fitting.problems import follow, observing

from pinav import fitting
from pinav.dynamics import FixedStep, Swimmer
from pinav.errors import InputError
from pinav.fitting.matching.damped_steps import DAMPINGS, LinearisedResiduals, full_step
from pinav.fitting.matching.gauss_newton import DampedState
from pinav.fitting.matching.state import split_trainable
from pinav.fitting.matching.windows import Windows
from pinav.forces import GaussianBarrier, LinearDrag, ZeroForce

TRUTH = Swimmer(ZeroForce(), LinearDrag(0.5), GaussianBarrier(2.0, [1.0, 0.2], 0.8))
OBJECTIVE = fitting.TrajectoryLoss(FixedStep(substeps=4))


@pytest.fixture(scope="module")
def data():
    starts = [[-1.0, 0.1, 1.5, 0.1], [-0.5, 1.0, 1.0, -0.4]]
    return follow(TRUTH, starts, [np.arange(31) * 0.1, np.arange(24) * 0.1])


@pytest.fixture(scope="module")
def learned(data):
    """The problem of the barrier, its parameters, and the vector of them."""
    params, static = split_trainable(TRUTH, lambda m: m.environment, np.float64)
    problem = fitting.Problem(
        static, fitting.Observations.of(data, np.float64), OBJECTIVE
    )
    return problem, params, ravel_pytree(params)[0]


@pytest.mark.slow
@pytest.mark.parametrize("window", [5, 100])
def test_propagated_defects_are_the_errors_of_rollouts_to_first_order(learned, window):
    problem, params, theta = learned
    windows = Windows.of(problem, params, jnp.asarray(window), FixedStep())
    nearby = theta * (1 + 1e-5)
    exact = windows.surrogate(nearby)[1]
    linear = windows.propagated_defects(nearby)(nearby)
    np.testing.assert_allclose(linear, exact, atol=1e-3 * np.abs(exact).max())


@pytest.mark.parametrize("shape", [(30, 8), (8, 30)])
def test_a_step_of_a_linear_problem_is_that_of_the_ridge(shape):
    rng = np.random.default_rng(1)
    matrix, wanted = jnp.asarray(rng.normal(size=shape)), rng.normal(size=shape[0])
    theta = jnp.asarray(rng.normal(size=shape[1]))

    def residuals(theta):
        return matrix @ theta - wanted

    problem = LinearisedResiduals(
        residuals, theta, residuals(theta), matrix, jnp.asarray(0.5)
    )
    step = full_step(problem)
    least = 0.5 * DAMPINGS[0]
    normal = matrix.T @ matrix + least * np.eye(shape[1])
    ridge = np.linalg.solve(normal, matrix.T @ residuals(theta))
    assert step.damping == pytest.approx(least)
    np.testing.assert_allclose(step.theta, theta - ridge, atol=1e-9)
    turned = np.linalg.qr(rng.normal(size=(shape[1], shape[1])))[0]
    same = full_step(problem, directions=jnp.asarray(turned))
    np.testing.assert_allclose(same.theta, step.theta, atol=1e-9)


@pytest.mark.slow
def test_what_the_data_leave_open_stays_where_the_prior_has_no_variance(learned):
    problem, params, theta = learned
    root = jnp.zeros((len(theta), 1), theta.dtype).at[0].set(1.0)
    phase = fitting.DefectMatching(jnp.asarray(100), 0.0, prior_root=root)
    windows = Windows.of(problem, params, phase.window, phase.linearisation)
    state = DampedState.begin(phase.damping, jnp.asarray(1.0, theta.dtype))
    step = phase.best_step(windows, 1.01 * theta, state)
    moved = np.asarray(step.theta - 1.01 * theta)
    assert moved[0] != 0.0
    np.testing.assert_array_equal(moved[1:], 0.0)
    more = fitting.DefectMatching(jnp.asarray(100), 0.0, prior_root=root[:-1])
    assert np.all(np.asarray(more.best_step(windows, 1.01 * theta, state).theta) != 0)


def test_a_step_that_lowers_nothing_stays():
    one, damping = jnp.ones(3), jnp.asarray(0.5)
    step = full_step(
        LinearisedResiduals(lambda theta: one * jnp.nan, one, one, jnp.eye(3), damping)
    )
    assert step.theta.tolist() == [1.0, 1.0, 1.0]
    assert step.damping == pytest.approx(50.0)
    assert step.left == 1.0


@pytest.mark.slow
def test_the_recipe_finds_the_constants_of_exact_data(data):
    start = eqx.tree_at(lambda m: m.environment.height, TRUTH, 1.0)
    result = fitting.fit(
        start,
        data,
        fitting.defect_recipe(data, precision=1e-9),
        trainable=lambda m: (m.environment, m.drag.damping),
        objective=OBJECTIVE,
        dtype=jnp.float64,
    )
    assert result.outcome is fitting.Outcome.CONVERGED
    assert result.model.environment.height == pytest.approx(2.0, rel=1e-6)
    assert [name for name, _ in result.phases] == ["Defects, L = 1", "Defects, L = 30"]


def test_bad_requests_are_refused(data):
    with pytest.raises(InputError, match="DefectMatching.steps: expected > 0, got 0"):
        fitting.defect_recipe(data, max_steps=0)
    hidden = data.observed.copy()
    hidden[0, 3] = False
    with pytest.raises(InputError, match="expected every state observed"):
        fitting.defect_recipe(observing(data, hidden))
