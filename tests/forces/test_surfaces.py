"""Surfaces that bound a fluid, and the flow and mobility that they make."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.errors import InputError
from pinav.forces import DoubleLayer, Plane, Tube, TubeFlow, WallMobility, tensor_matrix

VESSEL = Tube([3.0, 0.0, 4.0], [1.0, 2.0, 3.0], 2.0)
ACROSS = jnp.array([0.8, 0.0, -0.6])
"""A unit vector across the tube, as (0, 1, 0) is."""


@pytest.mark.parametrize("surface", [Plane([1.0, 2.0, -2.0], 0.7), VESSEL])
def test_the_normal_is_the_gradient_of_the_distance(surface):
    for offset in jax.random.normal(jax.random.key(0), (5, 3)):
        x = VESSEL.middle + offset
        slope = jax.grad(surface.distance)(x)
        np.testing.assert_allclose(surface.normal_at(x), slope, atol=1e-12)
        np.testing.assert_allclose(jnp.linalg.norm(slope), 1.0, rtol=1e-12)


def test_distances_in_a_tube():
    for along in (-7.0, 0.0, 4.0):
        axis = VESSEL.middle + along * VESSEL.axis
        np.testing.assert_allclose(VESSEL.distance(axis), 2.0, rtol=1e-11)
        off = axis + 0.5 * ACROSS + 1.2 * jnp.array([0.0, 1.0, 0.0])
        np.testing.assert_allclose(VESSEL.distance(off), 2.0 - 1.3)
        np.testing.assert_allclose(VESSEL.distance(axis + 2.5 * ACROSS), -0.5)


def test_on_the_axis_no_side_is_nearest_and_nothing_breaks():
    mobility = WallMobility(0.1, 1.0, VESSEL)
    matrix = jax.jacfwd(lambda x: mobility(x, ACROSS))(VESSEL.middle)
    assert jnp.all(jnp.isfinite(matrix))
    np.testing.assert_allclose(VESSEL.normal_at(VESSEL.middle), 0.0)


def test_a_wide_tube_has_the_mobility_and_repulsion_of_the_plane_that_touches_it():
    wide = Tube([1.0, 0.0, 0.0], [0.0, 0.0, 1e3], 1e3)
    floor, x = Plane([0.0, 0.0, 1.0]), jnp.array([4.0, 0.0, 1.7])
    for make in (
        lambda wall: tensor_matrix(WallMobility(1.0, 1.0, wall), x),
        lambda wall: DoubleLayer(2.0, 0.3, 1.0, wall)(0.0, x, x),
    ):
        np.testing.assert_allclose(make(wide), make(floor), atol=1e-10)


def test_the_flow_in_a_tube_carries_half_its_peak_times_the_area():
    flow = TubeFlow(3.0, VESSEL)
    radius = (jnp.arange(400.0) + 0.5) / 200
    speeds = jax.vmap(lambda r: flow(0.0, VESSEL.middle + r * ACROSS))(radius)
    volume = jnp.sum(speeds @ VESSEL.axis * 2 * jnp.pi * radius) / 200
    np.testing.assert_allclose(volume, 0.5 * 3.0 * jnp.pi * 4.0, rtol=1e-5)
    np.testing.assert_allclose(speeds @ ACROSS, 0.0, atol=1e-12)
    np.testing.assert_array_equal(flow(0.0, VESSEL.middle + 2.1 * ACROSS), jnp.zeros(3))


def test_a_pulse_swings_about_the_mean():
    flow = TubeFlow(-3.0, VESSEL, pulse=0.4, frequency=2.0)
    speeds = [flow(t, VESSEL.middle) @ VESSEL.axis for t in (0.0, 0.125, 0.375, 0.5)]
    np.testing.assert_allclose(speeds, [-3.0, -4.2, -1.8, -3.0], rtol=1e-9)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Tube([0.0] * 3, [0.0] * 3, 1.0), "Tube.along: expected a vector that"),
        (lambda: Tube([1.0, 0.0], [0.0] * 3, 1.0), "Tube.along: expected a point"),
        (lambda: Tube([1.0, 0.0, 0.0], [0.0], 1.0), "Tube.middle: expected a point"),
        (lambda: Tube([1.0, 0.0, 0.0], [0.0] * 3, 0.0), "Tube.radius: expected > 0"),
    ],
)
def test_values_that_make_no_sense_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
