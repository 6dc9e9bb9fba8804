import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pinav.dynamics import rollout
from pinav.errors import InputError
from pinav.forces import ZeroForce
from pinav.scenarios import SCENARIOS, paper, scenario


@pytest.fixture(scope="module")
def truth(paper_trajectories):
    return paper_trajectories.trajectory(0)


def test_physics_only_row_is_the_published_one(truth):
    """The row the constants were identified from; the paper prints two decimals."""
    known = paper()
    physics_only = eqx.tree_at(lambda s: s.environment, known.truth, ZeroForce())
    ys = eqx.filter_jit(rollout)(physics_only, known.starts[0], known.times).ys
    columns = np.sqrt(np.mean((np.asarray(ys) - truth.states) ** 2, axis=0))
    np.testing.assert_allclose(columns, [4.336, 2.460, 0.490, 0.389], rtol=5e-3)
    np.testing.assert_allclose(np.sqrt(np.mean(columns**2)), 2.512, rtol=5e-3)


def test_truth_agrees_with_an_independent_solution(truth):
    def slope(t, y):
        dx, dy = y[0] - 5.0, y[1] - 5.0
        push = 5.25 / 2.9**2 * np.exp(-(dx**2 + dy**2) / (2 * 2.9**2))
        return [
            y[2],
            y[3],
            push * dx - 0.36 * y[2],
            push * dy - 0.36 * y[3] + 0.034,
        ]

    solution = solve_ivp(
        slope,
        (0.0, 50.0),
        [0.0, 0.0, 3.503477, 3.439507],
        "DOP853",
        t_eval=truth.times,
        rtol=1e-13,
        atol=1e-13,
    )
    np.testing.assert_allclose(truth.states, solution.y.T, rtol=0, atol=1e-6)


def test_swimmer_stalls_on_the_barrier_and_then_rolls_off(truth):
    speed = np.linalg.norm(truth.states[:, 2:], axis=1)
    climbing, falling = truth.times < 14.0, truth.times > 14.0
    np.testing.assert_allclose(speed[climbing].min(), 0.0185, rtol=0.02)
    stall = truth.times[climbing][speed[climbing].argmin()]
    spike = truth.times[falling][speed[falling].argmax()]
    np.testing.assert_allclose(stall, 7.2, atol=0.11)
    np.testing.assert_allclose(spike, 16.6, atol=0.1)


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_fits_together(name):
    made = scenario(name)
    assert made.name == name
    assert made.starts.shape[1] == len(made.channels)
    assert set(made.units) == {*made.channels, "t"}
    assert jnp.all(jnp.diff(made.times) > 0)
    slope = made.truth(made.times[0], made.starts[0])
    assert slope.shape == made.starts[0].shape


def test_unknown_scenario_is_refused_with_the_known_ones():
    with pytest.raises(InputError, match="'papper' is unknown; choose one of: .*paper"):
        scenario("papper")
