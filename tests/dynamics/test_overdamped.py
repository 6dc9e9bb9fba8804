"""First-order dynamics: closed forms, the limit of strong drag, order, trajectories."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from pinav import forces
from pinav.dynamics import RK4, Adaptive, FixedStep, OverdampedSwimmer, Swimmer, rollout
from pinav.errors import InputError

TS = jnp.linspace(0.0, 2.0, 21)
Y0 = jnp.array([-1.5, 0.3])


def crossing(scale=1.0):
    """Forces that grow with `scale` while the mobility shrinks."""
    barrier = forces.GaussianBarrier(scale * 0.8, [0.0, 0.0], 0.8)
    return forces.ConstantForce([scale, 0.0]), barrier


@pytest.fixture(scope="module")
def solve():
    return eqx.filter_jit(rollout)


def test_the_flow_carries_and_the_mobility_moves_along_the_sum_of_all_forces():
    push, barrier = crossing()
    trap, flow = forces.HarmonicTrap(0.4, [0.5, 1.0]), forces.ShearFlow(0.3, 1.0)
    mobility = forces.UniaxialTensor(0.2, 0.5, forces.ConstantDirector(0.4))
    swimmer = OverdampedSwimmer(push, barrier, mobility, flow, trap)
    total = sum(force(0.0, Y0, jnp.zeros(2)) for force in (push, barrier, trap))
    expected = flow(0.0, Y0) + forces.tensor_matrix(mobility, Y0) @ total
    np.testing.assert_allclose(swimmer(0.0, Y0), expected, rtol=1e-13)


def test_drag_among_the_forces_is_without_effect():
    push, barrier = crossing()
    plain = OverdampedSwimmer(push, barrier, 1.0)
    with_drag = OverdampedSwimmer(push, barrier + forces.LinearDrag(5.0), 1.0)
    np.testing.assert_array_equal(plain(0.0, Y0), with_drag(0.0, Y0))


def test_it_is_the_limit_of_strong_drag(solve):
    """The velocity lags by 1/eta, so the error halves where eta doubles."""
    first = OverdampedSwimmer(*crossing(), mobility=1.0)
    limit = np.asarray(solve(first, Y0, TS).ys)
    start = jnp.concatenate([Y0, first(0.0, Y0)])

    def error(eta):
        push, barrier = crossing(eta)
        second = Swimmer(push, forces.LinearDrag(eta), barrier)
        ys = solve(second, start, TS, solver=FixedStep(substeps=25)).ys
        return np.abs(np.asarray(ys)[:, :2] - limit).max()

    assert error(400.0) < 5e-3
    np.testing.assert_allclose(error(200.0) / error(400.0), 2.0, rtol=0.1)


def test_rk4_is_of_fourth_order_on_first_order_dynamics(solve):
    swimmer = OverdampedSwimmer(*crossing(), mobility=1.0)
    ts = TS[::2]
    exact = solve(swimmer, Y0, ts, solver=Adaptive(1e-13, 1e-13)).ys

    def error(substeps):
        ys = solve(swimmer, Y0, ts, solver=FixedStep(RK4, substeps)).ys
        return float(jnp.abs(ys - exact).max())

    assert 3.8 < np.log2(error(4) / error(8)) < 4.2


def test_a_mobility_is_positive_and_a_leaf_that_can_be_replaced():
    with pytest.raises(InputError, match=r"IsotropicTensor.value: expected > 0, got 0"):
        OverdampedSwimmer(forces.ZeroForce(), forces.ZeroForce(), 0.0)
    swimmer = OverdampedSwimmer(*crossing(), mobility=1.0)
    double = eqx.tree_at(lambda s: s.mobility.value, swimmer, 2.0)
    np.testing.assert_allclose(double(0.0, Y0), 2.0 * swimmer(0.0, Y0))
