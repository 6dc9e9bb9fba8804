import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.dynamics import (
    Adaptive,
    FixedStep,
    ForwardOnly,
    NeuralDynamics,
    Outcome,
    Swimmer,
    paper_black_box,
    rollout,
    with_dtype,
)
from pinav.errors import InputError
from pinav.forces import AbstractForce, LinearDrag, ZeroForce, tanh_network

TS = jnp.arange(4.0)
Y0 = jnp.array([0.0, 0.0, 1.0, -2.0])


class CubicPush(AbstractForce):
    """A force that grows with the cube of the speed: infinite in finite time."""

    def __call__(self, t, x, v):
        return v**3


def coasting():
    return Swimmer(ZeroForce(), LinearDrag(0.5), ZeroForce())


def exploding():
    return Swimmer(ZeroForce(), ZeroForce(), CubicPush())


@pytest.fixture(scope="module")
def solve():
    return eqx.filter_jit(rollout)


def test_swimmer_adds_its_forces_to_the_acceleration():
    forces = [LinearDrag(size) for size in (1.0, 10.0, 100.0, 1000.0)]
    swimmer = Swimmer(*forces[:3], known_force=forces[3])
    np.testing.assert_allclose(swimmer(0.0, Y0), [1.0, -2.0, -1111.0, 2222.0])


@pytest.mark.parametrize("dim", [1, 3])
def test_swimmer_takes_any_dimension(dim):
    y = jnp.ones(2 * dim)
    expected = np.repeat([1.0, -0.5], dim)
    np.testing.assert_array_equal(coasting()(0.0, y), expected)


def test_rollout_takes_host_arrays(solve):
    run = rollout(coasting(), np.asarray(Y0), np.asarray(TS), solver=FixedStep())
    expected = solve(coasting(), Y0, TS).ys
    np.testing.assert_allclose(run.ys, expected, atol=1e-3)


@pytest.mark.parametrize(
    ("solver", "outcome"),
    [
        (FixedStep(), Outcome.DIVERGED),
        (Adaptive(max_steps=50), Outcome.OUT_OF_STEPS),
        (ForwardOnly(Adaptive(max_steps=50)), Outcome.OUT_OF_STEPS),
    ],
    ids=["diverged", "out of steps", "out of steps, forward only"],
)
def test_failure_is_an_outcome_or_raises(solve, solver, outcome):
    ts = jnp.linspace(0.0, 30.0, 31)
    run = solve(exploding(), Y0, ts, solver=solver, throw=False)
    assert run.outcome == outcome
    assert jnp.all(jnp.isfinite(run.ys[0]))
    with pytest.raises(RuntimeError, match="rollout failed: .*pass throw=False"):
        solve(exploding(), Y0, ts, solver=solver)


def test_outcome_is_one_per_swimmer_under_vmap():
    def end(y0):
        ts = jnp.arange(30.0)
        return rollout(exploding(), y0, ts, solver=FixedStep(), throw=False).outcome

    outcomes = jax.jit(jax.vmap(end))(jnp.stack([Y0, jnp.zeros(4)]))
    assert outcomes.tolist() == [Outcome.DIVERGED, Outcome.SUCCESS]


@pytest.mark.parametrize(
    ("y0", "ts", "message"),
    [
        (jnp.zeros((2, 4)), TS, r"rollout y0: expected one state .*\(2, 4\)"),
        (Y0, TS[:1], r"rollout ts: expected two or more times, got shape \(1,\)"),
        (Y0, TS[:, None], r"rollout ts: .* got shape \(4, 1\)"),
    ],
)
def test_bad_arguments_are_named(y0, ts, message):
    with pytest.raises(InputError, match=message):
        rollout(coasting(), y0, ts)


def test_black_box_sees_state_and_time_centred_and_scaled():
    network = tanh_network(5, 4, width=3, depth=1, key=jax.random.key(0))
    model = NeuralDynamics(network, center=(1.0,) * 5, scale=(2.0,) * 5)
    expected = network(jnp.array([-0.5, -0.5, 0.0, -1.5, 0.25]))
    np.testing.assert_allclose(model(1.5, Y0), expected)


def test_paper_black_box_has_the_shape_of_the_paper_network():
    layers = paper_black_box(jax.random.key(0)).network.layers
    assert [layer.weight.shape for layer in layers] == [(32, 5), (32, 32), (4, 32)]


def test_with_dtype_casts_weights_and_rollout_follows(solve):
    model = with_dtype(paper_black_box(jax.random.key(0)), jnp.float32)
    arrays = jax.tree.leaves(eqx.filter(model, eqx.is_array))
    assert {leaf.dtype for leaf in arrays} == {jnp.dtype("float32")}
    run = solve(model, Y0.astype(jnp.float32), TS, solver=FixedStep())
    assert run.ys.dtype == jnp.float32
