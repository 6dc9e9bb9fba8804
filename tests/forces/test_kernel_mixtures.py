"""Kernels with a rotational part, and kernels in time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.interpolate

from pinav.errors import InputError
from pinav.forces import (
    ChangingPotential,
    GaussianSwirl,
    KernelMixture,
    KernelPotential,
    KernelStream,
    TimedKernelPotential,
    cubic_spline,
)

CENTERS = jnp.array([[4.0, 5.0], [5.0, 5.5], [4.5, 6.5]])
WEIGHTS = jnp.array([0.3, -0.2, 0.5])
X = jnp.array([4.2, 5.5])
STREAM = KernelStream(WEIGHTS, CENTERS, 1.3)
POTENTIAL = KernelPotential(WEIGHTS, CENTERS, 1.3)
RNG = np.random.default_rng(0)
MOVING = TimedKernelPotential(
    jnp.asarray(RNG.normal(size=(3, 7))), CENTERS, 1.3, 2.0, 6.0
)


def jacobian(force, t=0.0):
    return jax.jacfwd(lambda x: force(t, x, jnp.zeros(2)))(X)


def test_a_stream_has_no_divergence_and_turns_as_its_function_says():
    slope = jax.grad(STREAM.stream)(X)
    expected = jnp.stack([slope[1], -slope[0]])
    np.testing.assert_allclose(STREAM(0.0, X, X), expected, rtol=1e-12)
    assert abs(jnp.trace(jacobian(STREAM))) < 1e-12
    laplacian = jnp.trace(jax.hessian(STREAM.stream)(X))
    curl = jacobian(STREAM)[1, 0] - jacobian(STREAM)[0, 1]
    np.testing.assert_allclose(curl, -laplacian, rtol=1e-12)


def test_one_kernel_of_a_stream_is_a_swirl():
    one = KernelStream(jnp.array([2.0]), CENTERS[:1], 1.3)
    swirl = GaussianSwirl(2.0, CENTERS[0], 1.3)
    np.testing.assert_allclose(one(0.0, X, X), swirl(0.0, X, X), rtol=1e-12)


def test_a_mixture_is_the_sum_of_its_parts():
    mixture = KernelMixture(POTENTIAL, STREAM)
    expected = POTENTIAL(0.0, X, X) + STREAM(0.0, X, X)
    np.testing.assert_allclose(mixture(0.0, X, X), expected, rtol=1e-14)
    assert [p.shape for p in mixture.parameters] == [(3,), (3,)]


@pytest.mark.parametrize("t", [0.0, 2.0, 3.3, 6.0, 9.0])
def test_weights_that_do_not_change_make_a_static_potential(t):
    constant = TimedKernelPotential(
        jnp.repeat(WEIGHTS[:, None], 7, axis=1), CENTERS, 1.3, 2.0, 6.0
    )
    np.testing.assert_allclose(constant(t, X, X), POTENTIAL(t, X, X), rtol=1e-12)


def test_a_changing_potential_is_the_sum_of_its_parts():
    changing = ChangingPotential(POTENTIAL, MOVING)
    expected = POTENTIAL(2.5, X, X) + MOVING(2.5, X, X)
    np.testing.assert_allclose(changing(2.5, X, X), expected, rtol=1e-14)
    force = -jax.grad(changing.potential, argnums=1)(2.5, X)
    np.testing.assert_allclose(force, expected, rtol=1e-12)


@pytest.mark.parametrize("t", [2.0, 3.3, 5.9])
def test_a_moving_potential_has_the_force_of_its_gradient(t):
    force = -jax.grad(MOVING.potential, argnums=1)(t, X)
    np.testing.assert_allclose(MOVING(t, X, X), force, rtol=1e-12)
    np.testing.assert_allclose(MOVING.at(t).potential(t, X), MOVING.potential(t, X))


def test_its_splines_are_those_of_scipy():
    times = np.linspace(2.0, 6.0, 23)[1:-1]
    knots = np.arange(-3, 8) + 2.0
    expected = scipy.interpolate.BSpline.design_matrix(times, knots, 3).toarray()
    values = jax.vmap(MOVING.splines)(jnp.asarray(times))
    np.testing.assert_allclose(values, expected, atol=1e-12)
    np.testing.assert_allclose(
        cubic_spline(jnp.array([0.0, 1.0, 2.0])), [2 / 3, 1 / 6, 0.0], atol=1e-15
    )


def test_wrong_shapes_are_refused():
    with pytest.raises(InputError, match="expected points in the plane"):
        KernelStream(WEIGHTS, jnp.zeros((3, 3)), 1.0)
    with pytest.raises(InputError, match="width: expected > 0, got 0.0"):
        KernelStream(WEIGHTS, CENTERS, 0.0)
    with pytest.raises(InputError, match=r"expected shape \(3, 4\)"):
        TimedKernelPotential(jnp.zeros((3, 2)), CENTERS, 1.0, 0.0, 1.0)
    with pytest.raises(InputError, match="expected last > first, got 0.0 and 1.0"):
        TimedKernelPotential(jnp.zeros((3, 5)), CENTERS, 1.0, 1.0, 0.0)
