import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pinav.dynamics import FixedStep, rollout
from pinav.errors import InputError
from pinav.scenarios import SCENARIOS, barrier_crossings, paper, scenario
from pinav.trajectories import simulate

KEY = jax.random.key(1)
CURRENTS = {name for name in SCENARIOS if name.endswith("-current")}
SPATIAL = {"box", "above-wall", "tube", "bifurcation"}
OTHERS = SPATIAL | {"paper", "brownian", "wall", "ring"}
PLANAR = sorted(SCENARIOS.keys() - OTHERS - CURRENTS)
RK = FixedStep(substeps=2)


@pytest.fixture(scope="module")
def truth(paper_trajectories):
    return paper_trajectories.trajectory(0)


def test_physics_only_row_is_the_published_one(truth):
    """The row the constants were identified from; the paper prints two decimals."""
    known = paper()
    physics_only = known.truth.without_environment()
    ys = eqx.filter_jit(rollout)(physics_only, known.starts[0], known.times).ys
    columns = np.sqrt(np.mean((np.asarray(ys) - truth.states) ** 2, axis=0))
    np.testing.assert_allclose(columns, [4.336, 2.460, 0.490, 0.389], rtol=5e-3)
    np.testing.assert_allclose(np.sqrt(np.mean(columns**2)), 2.512, rtol=5e-3)


def test_truth_agrees_with_an_independent_solution(truth):
    def slope(t, y):
        dx, dy = y[0] - 5.0, y[1] - 5.0
        push = 5.25 / 2.9**2 * np.exp(-(dx**2 + dy**2) / (2 * 2.9**2))
        return [y[2], y[3], push * dx - 0.36 * y[2], push * dy - 0.36 * y[3] + 0.034]

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
    assert jnp.all(jnp.isfinite(slope))


@pytest.mark.parametrize("name", sorted(SCENARIOS.keys() - {"paper"}))
def test_a_key_changes_the_starts_alone_and_more_of_it_begin_with_the_same(name):
    few, many = (scenario(name, KEY, count=count) for count in (3, 11))
    assert many.starts.shape[0] == 11
    np.testing.assert_array_equal(many.starts[:3], few.starts)
    assert not np.allclose(scenario(name, count=3).starts, few.starts)
    assert eqx.tree_equal(scenario(name).truth, few.truth)


def test_barrier_crossings_are_those_that_were_published():
    starts = barrier_crossings().starts
    expected = [11.875582, 3.686084, -3.791512, 1.636989]
    assert starts.shape == (8, 4)
    np.testing.assert_allclose(starts[0], expected, atol=1e-6)


@pytest.mark.parametrize("name", PLANAR)
def test_trajectories_are_about_as_large_as_the_domain(name):
    made = scenario(name)
    solve = eqx.filter_jit(
        jax.vmap(lambda y0: rollout(made.truth, y0, made.times, solver=RK).ys)
    )
    paths = np.asarray(solve(made.starts))[..., :2]
    extent = np.ptp(paths, axis=(0, 1))
    assert np.all(extent > 15.0)
    assert np.all(extent < 32.0)
    way = np.linalg.norm(paths[:, -1] - paths[:, 0], axis=1)
    assert np.median(way) > 3.0


def test_rotational_fraction_of_the_swirl():
    """By quadrature over the plane, as documented; the parts are orthogonal."""
    barrier, rotation = scenario("swirl").environment.terms
    axis = jnp.arange(-20.0, 30.0, 0.25)
    points = jnp.stack(jnp.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    gradient, rotational = (
        jnp.sum(jax.vmap(lambda x, f=f: f(0.0, x, x))(points) ** 2)
        for f in (barrier, rotation)
    )
    fraction = rotational / (gradient + rotational)
    np.testing.assert_allclose(fraction, 9.0 / (9.0 + 5.25**2), rtol=1e-6)


def test_a_stochastic_scenario_has_si_values_and_needs_a_key():
    made = scenario("brownian", count=3)
    diffusion = made.truth.diffusion(jnp.zeros(2))
    np.testing.assert_allclose(diffusion, 0.2454 * np.eye(2), rtol=1e-3)
    assert (made.units["x"], made.units["t"]) == ("um", "s")
    with pytest.raises(InputError, match="'brownian' is stochastic; pass key="):
        simulate(made)
    assert eqx.tree_equal(made.true_swimmer, made.truth.swimmer)
    assert eqx.tree_equal(made.swimmer, made.truth.swimmer.without_environment())


@pytest.mark.slow
def test_stochastic_trajectories_diffuse_and_belong_to_their_key():
    def observed(count):
        made = scenario("brownian", count=count)
        short = eqx.tree_at(lambda s: s.times, made, made.times[:61])
        return simulate(short, key=KEY)

    first, fewer = observed(12), observed(2)
    np.testing.assert_allclose(fewer.states, first.states[:2], atol=1e-12)
    assert first.channels == ("x", "y")
    assert first.provenance["solver"] == "Euler-Maruyama"
    assert first.provenance["substeps"] == 8
    steps = np.diff(first.states, axis=1)
    measured = np.var(steps) / 2 * 24  # drift adds a hundredth
    error = 4 * np.sqrt(2 / steps.size) + 0.02
    np.testing.assert_allclose(measured, 0.2454, rtol=error)


@pytest.mark.parametrize("name", ["barrier-crossings", "many-barriers", "brownian"])
def test_a_count_is_positive(name):
    with pytest.raises(InputError, match="starts count: expected 1 or more, got 0"):
        scenario(name, count=0)


def test_a_count_is_positive_and_that_of_the_paper_one():
    assert len(scenario("paper", count=1).starts) == 1
    with pytest.raises(InputError, match="'paper' has one fixed start"):
        scenario("paper", count=8)
    with pytest.raises(InputError, match="'papper' is unknown; choose one of: .*paper"):
        scenario("papper")


def test_the_moving_barrier_comes_round_once_in_twenty():
    force, v = scenario("moving-barrier").truth.environment, jnp.zeros(2)
    middle, place = jnp.array([5.0, 5.0]), jnp.array([1.3, 0.4])
    at = force(0.0, middle + place, v)
    np.testing.assert_allclose(force(20.0, middle + place, v), at, atol=1e-12)
    np.testing.assert_allclose(force(10.0, middle - place, v), -at, atol=1e-12)
    quarter = force(5.0, middle + jnp.array([-0.4, 1.3]), v)
    np.testing.assert_allclose(quarter, [-at[1], at[0]], atol=1e-12)
    assert np.hypot(*at) > 0.01
