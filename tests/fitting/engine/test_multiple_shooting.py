import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.fitting.problems import STATES

from pinav.dynamics import RK4, FixedStep, Swimmer
from pinav.fitting.engine.local_model import ravel_model
from pinav.fitting.engine.multiple_shooting import (
    advance,
    eliminate,
    linearise,
    predict,
    pull_back,
    sensitivities,
)
from pinav.fitting.matching.state import Observations
from pinav.forces import KernelForce, KernelPotential, LinearDrag, ZeroForce
from pinav.trajectories import Trajectories

SOLVER = FixedStep(RK4)
CENTERS = jnp.array([[0.0, 0.0], [1.0, 0.2], [0.4, 1.1]])
ENVIRONMENTS = {
    "potential": KernelPotential(jnp.array([0.3, -0.5, 0.8]), CENTERS, 0.8),
    "force": KernelForce(0.5 * jnp.cos(jnp.arange(6.0)).reshape(3, 2), CENTERS, 0.8),
}
GENERATOR = np.random.default_rng(0)
TIMES = np.cumsum(GENERATOR.uniform(0.05, 0.2, 20))
SHORT = TIMES[:13] ** 1.1
STARTS = jnp.array([[-1.0, 0.1, 1.2, 0.3], [1.5, -0.5, -0.4, 0.9]])


def ravelled(environment):
    swimmer = Swimmer(ZeroForce(), LinearDrag(jnp.array(0.4)), environment)
    return ravel_model(swimmer, lambda m: (m.environment.weights, m.drag.damping))


@eqx.filter_jit
def plain_rollout(free, theta, y0, times):
    """Step after step, differentiated by JAX alone."""

    def advance(y, interval):
        y = SOLVER.step(free(theta), y, interval[0], interval[1])
        return y, y

    _, later = jax.lax.scan(advance, y0, jnp.stack([times[:-1], times[1:]], axis=1))
    return jnp.concatenate([y0[None], later])


@pytest.fixture(scope="module")
def problem():
    """Two trajectories of different lengths with holes, states off the dynamics."""
    free, theta = ravelled(ENVIRONMENTS["potential"])
    times = [TIMES, SHORT]
    states = [
        np.asarray(plain_rollout(free, theta, y0, ts))
        + 0.05 * GENERATOR.normal(size=(len(ts), 4))
        for y0, ts in zip(STARTS, times, strict=True)
    ]
    observed = [GENERATOR.uniform(size=y.shape) > 0.3 for y in states]
    data = Trajectories.from_arrays(times, states, channels=STATES, observed=observed)
    lifted = np.array(data.states)
    for index, own in enumerate(states):
        lifted[index, : len(own)] = own + 0.1 * np.sin(np.arange(len(own)))[:, None]
        lifted[index, len(own) :] = lifted[index, len(own) - 1]
    return free, theta, jnp.asarray(lifted), Observations.of(data, jnp.float64)


@pytest.mark.parametrize(
    "kind", ["force", pytest.param("potential", marks=pytest.mark.slow)]
)
def test_without_defects_the_columns_are_the_jacobian_of_the_rollout(kind):
    free, theta = ravelled(ENVIRONMENTS[kind])
    times = jnp.asarray(TIMES)
    ys = plain_rollout(free, theta, STARTS[0], times)
    by_theta, by_start = jax.jacrev(
        lambda theta, y0: plain_rollout(free, theta, y0, times), (0, 1)
    )(theta, STARTS[0])
    found = eqx.filter_jit(sensitivities)(free, theta, ys, times, SOLVER)
    np.testing.assert_allclose(found.defects, 0, atol=1e-14)
    expected = np.concatenate([by_theta, by_start], axis=2)
    np.testing.assert_allclose(found.columns[..., :-1], expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.columns[..., -1], 0, atol=1e-13)
    solved = jax.jacrev(lambda th: SOLVER.solve(free(th), STARTS[0], times)[0])(theta)
    np.testing.assert_allclose(solved, by_theta, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_with_defects_the_last_column_solves_the_linearised_dynamics(problem):
    free, theta, states, observations = problem
    u, times = states[0], observations.times[0]
    found = sensitivities(free, theta, u, times, SOLVER)
    corrected = u + found.columns[..., -1]

    def step(y, change, t0, t1):
        return jax.jvp(lambda y: SOLVER.step(free(theta), y, t0, t1), (y,), (change,))

    later, changes = jax.vmap(step)(u[:-1], (corrected - u)[:-1], times[:-1], times[1:])
    np.testing.assert_allclose(corrected[1:], later + changes, atol=1e-12)


def dense(free, theta, states, observations):
    """Rows of all trajectories, each start with columns of its own, and residuals."""
    p, (count, _, n) = len(theta), states.shape
    rows, residuals = [], []
    for i in range(count):
        columns = eqx.filter_jit(sensitivities)(
            free, theta, states[i], observations.times[i], SOLVER
        ).columns
        seen = np.asarray(observations.observed[i])
        reach = np.asarray(columns)[seen]
        wide = np.zeros((len(reach), p + count * n))
        wide[:, :p] = reach[:, :p]
        wide[:, p + i * n : p + (i + 1) * n] = reach[:, p : p + n]
        rows.append(wide)
        residuals.append(
            np.asarray(states[i] - observations.states[i])[seen] + reach[:, -1]
        )
    return np.concatenate(rows), np.concatenate(residuals)


def test_elimination_and_step_are_those_of_dense_least_squares(problem):
    free, theta, states, observations = problem
    rows, residuals = dense(free, theta, states, observations)
    by_theta, starts = rows[:, : len(theta)], rows[:, len(theta) :]
    onto_rest = np.eye(len(rows)) - starts @ np.linalg.pinv(starts)
    found = linearise(free, theta, states, observations, SOLVER)
    for ours, exact in (
        (found.hessian, by_theta.T @ onto_rest @ by_theta),
        (found.gradient, by_theta.T @ onto_rest @ residuals),
        (found.squares, residuals @ onto_rest @ residuals),
    ):
        np.testing.assert_allclose(ours, exact, rtol=1e-9)
    step = -np.linalg.lstsq(rows, residuals, rcond=None)[0]
    change = jnp.linalg.solve(found.hessian, -found.gradient)
    np.testing.assert_allclose(change, step[: len(theta)], rtol=1e-8)
    moved = advance(states, found, change)
    starts = step[len(theta) :].reshape(2, 4)
    np.testing.assert_allclose(moved[:, 0] - states[:, 0], starts, rtol=1e-7)


@pytest.mark.slow
def test_padding_adds_nothing(problem):
    free, theta, states, observations = problem
    both = linearise(free, theta, states, observations, SOLVER)

    def alone(index, length):
        own = jax.tree.map(lambda a: a[index : index + 1, :length], observations)
        return linearise(free, theta, states[index : index + 1, :length], own, SOLVER)

    first, second = alone(0, len(TIMES)), alone(1, len(SHORT))
    total = first.hessian + second.hessian
    np.testing.assert_allclose(both.hessian, total, rtol=1e-10)
    np.testing.assert_allclose(both.squares, first.squares + second.squares)


@pytest.mark.slow
def test_steps_from_states_off_the_dynamics_reach_a_solution(problem):
    free, theta, states, observations = problem
    for _ in range(8):
        found = linearise(free, theta, states, observations, SOLVER)
        change = jnp.linalg.solve(found.hessian, -found.gradient)
        theta, states = theta + change, advance(states, found, change)
    rollout = plain_rollout(free, theta, states[0, 0], observations.times[0])
    np.testing.assert_allclose(states[0], rollout, atol=1e-6)
    assert eqx.tree_equal(free(theta).environment.centers, CENTERS)


def test_a_prediction_leaves_the_squares_and_the_gradient_of_the_linearisation(problem):
    free, theta, states, observations = problem
    found = linearise(free, theta, states, observations, SOLVER)
    here = predict(free, theta, states, observations, SOLVER)
    np.testing.assert_allclose(np.sum(here.residuals**2), found.squares, rtol=1e-9)
    np.testing.assert_allclose(
        pull_back(found, here.residuals), found.gradient, rtol=1e-8
    )
    moved = advance(states, found, jnp.zeros_like(theta))
    np.testing.assert_allclose(here.states, moved, atol=1e-9)


def test_starts_are_eliminated_to_all_digits_from_an_unstable_path():
    rng = np.random.default_rng(0)
    basis, _ = np.linalg.qr(rng.normal(size=(40, 3)))
    growth = np.diag([1.0, 1e4, 1e9]) @ rng.normal(size=(3, 3))
    others = rng.normal(size=(40, 5))
    rows = np.concatenate([others[:, :2], basis @ growth, others[:, 2:]], axis=1)
    rest, factor, start_rows = eliminate(jnp.asarray(rows), 2, 3)
    expected = others - basis @ (basis.T @ others)
    np.testing.assert_allclose(rest, expected, atol=1e-6)  # 1e-16 times 1e9, and more
    gram = growth.T @ growth
    np.testing.assert_allclose(factor.T @ factor, gram, atol=1e-14 * gram.max())
    left = others - rows[:, 2:5] @ np.asarray(start_rows)
    np.testing.assert_allclose(left, expected, atol=1e-5)


def test_fewer_rows_than_starts_leave_nothing():
    rng = np.random.default_rng(1)
    rest, factor, _ = eliminate(jnp.asarray(rng.normal(size=(2, 7))), 3, 4)
    np.testing.assert_allclose(rest, 0.0, atol=1e-13)
    assert factor.shape == (4, 4)


@pytest.mark.parametrize("environment", ENVIRONMENTS.values(), ids=ENVIRONMENTS)
def test_a_model_outside_of_compiled_functions_is_the_same(environment):
    free, theta = ravelled(environment)
    placed = free.at(np.asarray(theta) + 0.1)
    assert eqx.tree_equal(placed, free(theta + 0.1))
