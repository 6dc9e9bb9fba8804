"""Kernels with a rotational part, in layers, and in time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.interpolate

from pinav import forces
from pinav.errors import InputError

CENTERS = jnp.array([[4.0, 5.0], [5.0, 5.5], [4.5, 6.5]])
WEIGHTS = jnp.array([0.3, -0.2, 0.5])
X = jnp.array([4.2, 5.5])
STREAM = forces.KernelStream(WEIGHTS, CENTERS, 1.3)
POTENTIAL = forces.KernelPotential(WEIGHTS, CENTERS, 1.3)
RNG = np.random.default_rng(0)
MOVING = forces.TimedKernelPotential(
    jnp.asarray(RNG.normal(size=(3, 7))), CENTERS, 1.3, 2.0, 6.0
)


def test_one_kernel_of_a_stream_is_a_swirl():
    one = forces.KernelStream(jnp.array([2.0]), CENTERS[:1], 1.3)
    swirl = forces.gaussian_swirl(2.0, CENTERS[0], 1.3)
    np.testing.assert_allclose(one(0.0, X, X), swirl(0.0, X, X), rtol=1e-12)


NARROW = forces.KernelPotential(jnp.array([0.4]), jnp.array([[0.5, 0.3]]), 0.3)
WHOLES = {
    "mixture": (forces.KernelMixture(POTENTIAL, STREAM), (POTENTIAL, STREAM)),
    "changing": (forces.ChangingPotential(POTENTIAL, MOVING), (POTENTIAL, MOVING)),
    "layered": (forces.LayeredPotential((POTENTIAL, NARROW)), (POTENTIAL, NARROW)),
    "one layer": (forces.LayeredPotential((POTENTIAL,)), (POTENTIAL,)),
}


@pytest.mark.parametrize(("whole", "parts"), WHOLES.values(), ids=WHOLES)
def test_a_force_of_parts_is_their_sum(whole, parts):
    expected = sum(part(2.5, X, X) for part in parts)
    np.testing.assert_allclose(whole(2.5, X, X), expected, rtol=1e-14)
    if hasattr(whole, "potential"):
        energy = sum(part.potential(2.5, X) for part in parts)
        np.testing.assert_allclose(whole.potential(2.5, X), energy, rtol=1e-14)


def test_the_two_parts_of_a_mixture_have_weights_of_their_own():
    shapes = [leaf.shape for leaf in forces.KernelMixture(POTENTIAL, STREAM).parameters]
    assert shapes == [(3,), (3,)]


@pytest.mark.parametrize("t", [0.0, 2.0, 3.3, 6.0, 9.0])
def test_weights_that_do_not_change_make_a_static_potential(t):
    constant = forces.TimedKernelPotential(
        jnp.repeat(WEIGHTS[:, None], 7, axis=1), CENTERS, 1.3, 2.0, 6.0
    )
    np.testing.assert_allclose(constant(t, X, X), POTENTIAL(t, X, X), rtol=1e-12)


def test_its_splines_are_those_of_scipy():
    times = np.linspace(2.0, 6.0, 23)[1:-1]
    knots = np.arange(-3, 8) + 2.0
    expected = scipy.interpolate.BSpline.design_matrix(times, knots, 3).toarray()
    values = jax.vmap(MOVING.splines)(jnp.asarray(times))
    np.testing.assert_allclose(values, expected, atol=1e-12)
    np.testing.assert_allclose(
        forces.cubic_spline(jnp.array([0.0, 1.0, 2.0])), [2 / 3, 1 / 6, 0.0], atol=1e-15
    )


def test_wrong_shapes_are_refused():
    with pytest.raises(InputError, match="expected points in the plane"):
        forces.KernelStream(WEIGHTS, jnp.zeros((3, 3)), 1.0)
    with pytest.raises(InputError, match="width: expected > 0, got 0.0"):
        forces.KernelStream(WEIGHTS, CENTERS, 0.0)
    with pytest.raises(InputError, match=r"expected shape \(3, 4\)"):
        forces.TimedKernelPotential(jnp.zeros((3, 2)), CENTERS, 1.0, 0.0, 1.0)
    with pytest.raises(InputError, match="expected last > first, got 0.0 and 1.0"):
        forces.TimedKernelPotential(jnp.zeros((3, 5)), CENTERS, 1.0, 1.0, 0.0)
    line = forces.KernelPotential(jnp.array([0.4]), jnp.array([[0.5]]), 0.3)
    for layers in ((), (POTENTIAL, line)):
        with pytest.raises(InputError, match="expected one or more, of one dimension"):
            forces.LayeredPotential(layers)
