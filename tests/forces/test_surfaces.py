"""Surfaces that bound a fluid, and the flow and mobility that they make."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from tests.refusals import refusals

from pinav import forces

VESSEL = forces.Tube([3.0, 0.0, 4.0], [1.0, 2.0, 3.0], 2.0)
FORK = forces.Bifurcation(
    [1.0, 2.0, 3.0],
    jnp.array([[-1.0, 0.0, 0.0], [2.0, 1.0, 0.0], [2.0, -1.0, 0.5]]),
    jnp.array([2.0, 1.5, 1.0]),
)
ACROSS = jnp.array([0.8, 0.0, -0.6])
"""A unit vector across the tube, as (0, 1, 0) is."""


@pytest.mark.parametrize(
    ("surface", "place"),
    [
        (forces.Plane([1.0, 2.0, -2.0], 0.7), VESSEL.middle),
        (VESSEL, VESSEL.middle),
        (FORK, FORK.middle + 9.0 * FORK.axes[0]),
        (FORK, FORK.middle + 9.0 * FORK.axes[2]),
    ],
)
def test_the_normal_is_the_gradient_of_the_distance(surface, place):
    for offset in jax.random.normal(jax.random.key(0), (5, 3)):
        x = place + 0.5 * offset
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
    mobility = forces.WallMobility(0.1, 1.0, VESSEL)
    matrix = jax.jacfwd(lambda x: mobility(x, ACROSS))(VESSEL.middle)
    assert jnp.all(jnp.isfinite(matrix))
    np.testing.assert_allclose(VESSEL.normal_at(VESSEL.middle), 0.0)


def test_a_wide_tube_has_the_mobility_and_repulsion_of_the_plane_that_touches_it():
    wide = forces.Tube([1.0, 0.0, 0.0], [0.0, 0.0, 1e3], 1e3)
    floor, x = forces.Plane([0.0, 0.0, 1.0]), jnp.array([4.0, 0.0, 1.7])
    for make in (
        lambda wall: forces.tensor_matrix(forces.WallMobility(1.0, 1.0, wall), x),
        lambda wall: forces.DoubleLayer(2.0, 0.3, 1.0, wall)(0.0, x, x),
    ):
        np.testing.assert_allclose(make(wide), make(floor), atol=1e-10)


def test_the_flow_in_a_tube_carries_half_its_peak_times_the_area():
    flow, radius = forces.TubeFlow(3.0, VESSEL), (jnp.arange(400.0) + 0.5) / 200
    speeds = jax.vmap(lambda r: flow(0.0, VESSEL.middle + r * ACROSS))(radius)
    volume = jnp.sum(speeds @ VESSEL.axis * 2 * jnp.pi * radius) / 200
    np.testing.assert_allclose(volume, 0.5 * 3.0 * jnp.pi * 4.0, rtol=1e-5)
    np.testing.assert_allclose(speeds @ ACROSS, 0.0, atol=1e-12)
    assert not flow(0.0, VESSEL.middle + 2.1 * ACROSS).any()


def test_a_pulse_swings_about_the_mean():
    flow = forces.TubeFlow(-3.0, VESSEL, pulse=0.4, frequency=2.0)
    speeds = [flow(t, VESSEL.middle) @ VESSEL.axis for t in (0.0, 0.125, 0.375, 0.5)]
    np.testing.assert_allclose(speeds, [-3.0, -4.2, -1.8, -3.0], rtol=1e-9)


def test_tubes_that_continue_each_other_are_a_tube():
    along = jnp.stack([VESSEL.along, -VESSEL.along])
    both = forces.Bifurcation(VESSEL.middle, along, jnp.full(2, VESSEL.radius))
    flows = (
        forces.TubeFlow(-3.0, VESSEL, pulse=0.4, frequency=2.0),
        forces.BifurcationFlow(3.0, both, jnp.ones(1), pulse=0.4, frequency=2.0),
    )
    for offset in jax.random.normal(jax.random.key(1), (8, 3)):
        x = VESSEL.middle + offset
        if VESSEL.distance(x) > 0:
            assert 0.95 < both.distance(x) / VESSEL.distance(x) <= 1 + 1e-12
            assert both.normal_at(x) @ VESSEL.normal_at(x) > 0.98
        far = x + 6.0 * VESSEL.axis
        np.testing.assert_allclose(both.distance(far), VESSEL.distance(far), rtol=1e-12)
        normals = both.normal_at(far), VESSEL.normal_at(far)
        np.testing.assert_allclose(*normals, atol=1e-12)
        one, other = (flow(0.3, x + 6.0 * VESSEL.axis) for flow in flows)
        np.testing.assert_allclose(one, other, atol=1e-12)
        one, other = (flow(0.3, x) @ VESSEL.axis for flow in flows)
        assert 0.8 * one >= other >= one  # both run backwards


@pytest.mark.slow
def test_where_tubes_meet_distance_and_flow_have_slopes_that_are_continuous():
    flow = forces.BifurcationFlow(3.0, FORK, jnp.array([0.6, 0.4]))
    beside = FORK.middle + jnp.array([0.5, 0.4, 0.3])  # off the axes, as the cusps are
    line = jnp.linspace(-1.4, 1.4, 2001)
    inside = jax.vmap(lambda s: FORK.distance(beside + s * ACROSS))(line) > 0.05
    slopes = jax.jacfwd(FORK.distance), jax.jacfwd(lambda x: flow(0.0, x))
    for function in (*slopes, FORK.normal_at):
        values = jax.vmap(lambda s, f=function: f(beside + s * ACROSS))(line)
        jumps = jnp.abs(jnp.diff(values, axis=0)).reshape(2000, -1).max(axis=1)
        assert float(jnp.max(jnp.where(inside[1:] & inside[:-1], jumps, 0.0))) < 0.05


def test_what_enters_a_bifurcation_leaves_it_by_its_shares():
    flow = forces.BifurcationFlow(3.0, FORK, jnp.array([0.7, 0.3]))
    rng, volumes = np.random.default_rng(0), []
    for axis, radius in zip(FORK.axes, FORK.radii, strict=True):
        across = np.linalg.qr(np.column_stack([axis, rng.normal(size=(3, 2))]))[0][:, 1]
        places = (jnp.arange(400.0) + 0.5) / 400 * radius
        line = (FORK.middle + 9.0 * axis)[None] + places[:, None] * across[None]
        speeds = jax.vmap(lambda x: flow(0.0, x))(line) @ axis
        volumes.append(float(jnp.sum(speeds * 2 * jnp.pi * places) * radius / 400))
    whole = 0.5 * 3.0 * np.pi * 4.0
    np.testing.assert_allclose(volumes, [-whole, 0.7 * whole, 0.3 * whole], rtol=1e-5)


@pytest.mark.slow
def test_the_fluid_rests_at_the_walls_of_a_bifurcation_and_is_smooth_in_it():
    flow = forces.BifurcationFlow(3.0, FORK, jnp.array([0.5, 0.5]))
    directions = jax.random.normal(jax.random.key(2), (6, 3))
    for direction in directions / jnp.linalg.norm(directions, axis=1, keepdims=True):
        end = scipy.optimize.brentq(
            lambda s, along=direction: FORK.distance(FORK.middle + s * along), 0.0, 60.0
        )
        wall = FORK.middle + end * direction
        np.testing.assert_allclose(flow(0.0, wall), 0.0, atol=1e-9)
    line = (
        FORK.middle[None] + jnp.linspace(-3.0, 6.0, 901)[:, None] * FORK.axes[1][None]
    )
    speeds = jax.vmap(lambda x: flow(0.0, x))(line)
    assert float(jnp.abs(jnp.diff(speeds, axis=0)).max()) < 0.1


test_values_that_make_no_sense_are_refused = refusals(
    (
        lambda: forces.Tube([0.0] * 3, [0.0] * 3, 1.0),
        "Tube.along: expected a vector that",
    ),
    (lambda: forces.Tube([1.0, 0.0], [0.0] * 3, 1.0), "Tube.along: expected a point"),
    (lambda: forces.Tube([1.0, 0.0, 0.0], [0.0], 1.0), "Tube.middle: expected a point"),
    (lambda: forces.Tube([1.0, 0.0, 0.0], [0.0] * 3, 0.0), "Tube.radius: expected > 0"),
    (
        lambda: forces.Bifurcation([0.0] * 3, jnp.ones((1, 3)), jnp.ones(1)),
        "Bifurcation.along: expected the directions of two tubes",
    ),
    (
        lambda: forces.Bifurcation([0.0] * 3, jnp.eye(3), jnp.ones(2)),
        "Bifurcation.radii: expected 3 of them",
    ),
    (
        lambda: forces.Bifurcation([0.0] * 3, jnp.eye(3), jnp.array([1.0, 0.0, 1.0])),
        "Bifurcation.radii: expected > 0",
    ),
    (
        lambda: forces.Bifurcation([0.0] * 3, jnp.zeros((2, 3)), jnp.ones(2)),
        "Bifurcation.along: expected vectors that are not zero",
    ),
    (
        lambda: forces.BifurcationFlow(1.0, FORK, jnp.ones(1)),
        "BifurcationFlow.shares: expected 2 of them",
    ),
    (
        lambda: forces.BifurcationFlow(1.0, FORK, jnp.array([0.5, 0.6])),
        "BifurcationFlow.shares: expected parts that sum to 1",
    ),
)
