import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from pinav.analysis import lyapunov_map
from pinav.dynamics import AbstractDynamics, OverdampedSwimmer, Swimmer, rollout
from pinav.errors import InputError
from pinav.forces import LinearDrag, LinearForce, ZeroForce
from pinav.scenarios import barrier_crossings

MATRIX = np.array([[0.3, 1.0], [-0.4, -0.2]])
TIMES = np.linspace(0.0, 2.0, 41)


def test_growth_in_a_linear_flow_is_that_of_its_exponential():
    flow = OverdampedSwimmer(
        ZeroForce(), LinearForce(jnp.asarray(MATRIX), [0.0, 0.0]), 1.0
    )
    axis = np.linspace(-1.0, 1.0, 3)
    found = lyapunov_map(flow, axis, axis, TIMES)
    exact = scipy.linalg.expm(2.0 * MATRIX)
    stretch = np.linalg.svd(exact, compute_uv=False)[0]
    assert np.allclose(found.separation, stretch, rtol=1e-7)
    assert np.allclose(found.exponent, np.log(stretch) / 2.0, rtol=1e-6)
    assert found.horizon == 2.0
    grid = np.stack(np.meshgrid(axis, axis), axis=-1)
    assert np.allclose(found.final, grid @ exact.T, atol=1e-7)


def test_drag_alone_keeps_positions_apart():
    coasting = Swimmer(ZeroForce(), LinearDrag(0.5), ZeroForce())
    axis = np.linspace(0.0, 1.0, 2)
    found = lyapunov_map(coasting, axis, axis, TIMES, velocity=lambda x: -x)
    assert np.allclose(found.separation, 1.0, atol=1e-12)
    assert np.allclose(found.exponent, 0.0, atol=1e-12)


def test_a_separation_is_that_of_finite_differences():
    swimmer, velocity = barrier_crossings().truth, np.array([2.0, 2.5])
    start = np.array([1.0, 2.0, *velocity])
    found = lyapunov_map(
        swimmer, start[:1], start[1:2], TIMES, velocity=lambda x: velocity
    )

    @jax.jit
    def end(y0):
        return rollout(swimmer, jnp.asarray(y0), jnp.asarray(TIMES)).ys[-1]

    step = 1e-5
    differences = [
        (end(start + step * unit) - end(start - step * unit))[:2] / (2 * step)
        for unit in np.eye(4)[:2]
    ]
    stretch = np.linalg.svd(np.stack(differences, axis=1), compute_uv=False).max()
    assert np.allclose(found.final[0, 0], end(start)[:2], atol=1e-6)
    assert np.allclose(found.separation, stretch, rtol=1e-4)


def test_a_rollout_that_is_not_finite_is_left_blank():
    class Trap(AbstractDynamics):
        def __call__(self, t, y):
            return jnp.where(y[:1] > 0.5, jnp.nan, 1.0) * y

    found = lyapunov_map(Trap(), np.array([0.0, 1.0]), np.zeros(1), TIMES)
    assert np.isnan(found.separation[0, 1])
    assert np.isfinite(found.separation[0, 0])


def test_bad_input_is_refused():
    swimmer, place = barrier_crossings().truth, np.zeros(1)
    with pytest.raises(InputError, match="expected two or more times"):
        lyapunov_map(swimmer, place, place, TIMES[:1])
