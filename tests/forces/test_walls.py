"""A sphere near a wall: published drags, limits, and Boltzmann's distribution."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.refusals import refusals
from validation.truth.known import brenner_mobility

from pinav.dynamics import BrownianSwimmer, OverdampedSwimmer
from pinav.forces import (
    DoubleLayer,
    Plane,
    WallMobility,
    Weight,
    ZeroForce,
    normal_mobility,
    parallel_mobility,
    stokes_drag,
    tensor_matrix,
)

RADIUS, HEAT = 1.516, 4.06e-3
FLOOR = Plane([0.0, 0.0, 2.0], 0.5)


def test_brenners_series_has_the_published_drags():
    """Brenner (1961), table 1: cosh of alpha from 0.5 to 3."""
    gaps = jnp.cosh(jnp.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0])) - 1
    drags = [9.2518, 3.0361, 1.8375, 1.4129, 1.2220, 1.1252]
    np.testing.assert_allclose(1 / brenner_mobility(gaps), drags, rtol=5e-5)


def test_the_rational_form_follows_brenners_series():
    gaps = jnp.geomspace(2e-3, 50.0, 100)
    series = brenner_mobility(gaps)
    np.testing.assert_allclose(normal_mobility(gaps), series, rtol=0.008)


def test_the_drag_along_a_wall_is_that_of_goldman_cox_and_brenner():
    """Chem. Eng. Sci. 22, 637 (1967), table 1: gaps from lubrication to far away."""
    gaps = jnp.array([0.003202, 0.005004, 0.0453, 0.1276, 0.5431, 2.7622, 9.0677])
    drags = [4.0223, 3.7863, 2.6475, 2.1514, 1.5675, 1.1738, 1.0591]
    np.testing.assert_allclose(1 / parallel_mobility(gaps), drags, rtol=1e-3)


@pytest.mark.parametrize(
    "mobility", [brenner_mobility, normal_mobility, parallel_mobility]
)
def test_a_mobility_grows_with_the_gap_and_is_that_of_stokes_far_away(mobility):
    gaps = jnp.geomspace(2e-3, 1e3, 400)
    values = mobility(gaps)
    assert jnp.all(jnp.diff(values) > 0)
    assert jnp.max(jnp.abs(jnp.diff(jnp.log(values)))) < 0.04  # no jump
    np.testing.assert_allclose(values[-1], 1.0, rtol=2e-3)
    assert jnp.all(mobility(jnp.array([0.0, -0.1])) > 0)


@pytest.mark.parametrize("normal", [[0.0, 1.0], [0.6, -0.8, 0.0]])
def test_the_mobility_is_a_tensor_with_the_walls_normal_as_its_axis(normal):
    plane = Plane(normal, -1.0)
    tensor = WallMobility(RADIUS, 1.0, plane)
    x = 1.3 * jnp.ones(len(normal)) + plane.unit_normal
    matrix = tensor_matrix(tensor, x)
    gap = tensor.gap(x)
    np.testing.assert_allclose(gap, (plane.distance(x) - RADIUS) / RADIUS)
    principal = jnp.sort(jnp.linalg.eigvalsh(matrix) * stokes_drag(RADIUS, 1.0))
    along = [float(parallel_mobility(gap))] * (len(normal) - 1)
    np.testing.assert_allclose(principal, [float(normal_mobility(gap)), *along])
    root = jax.vmap(lambda unit: tensor.factor(x, unit))(jnp.eye(len(normal)))
    np.testing.assert_allclose(root.T @ root, matrix, rtol=1e-12)


def test_boltzmanns_distribution_is_stationary_above_the_wall():
    r"""No current flows where p = exp(-U / kT): drift p - D dp/dz - p dD/dz = 0."""
    layer = DoubleLayer(17 * HEAT, 0.026, RADIUS, FLOOR)
    weight = Weight(RADIUS, 50.0, [0.0, 0.0, -1.0])
    mobility = WallMobility(RADIUS, 1.0, FLOOR)
    swimmer = OverdampedSwimmer(ZeroForce(), layer + weight, mobility)
    dynamics = BrownianSwimmer(swimmer, HEAT)

    def above(z):
        return jnp.array([0.0, 0.0, z])

    def energy(z):
        return layer.potential(0.0, above(z)) + weight.size * z

    def diffusion(z):
        return dynamics.diffusion(above(z))[2, 2]

    @jax.jit
    @jax.vmap
    def drift_and_expected(z):
        expected = jax.grad(diffusion)(z) - diffusion(z) * jax.grad(energy)(z) / HEAT
        return dynamics(0.0, above(z)), expected

    heights = 0.5 + RADIUS + jnp.array([0.03, 0.2, 0.4, 2.0])
    drift, expected = drift_and_expected(heights)
    np.testing.assert_allclose(drift[:, 2], expected, rtol=1e-9)
    np.testing.assert_allclose(drift[:, :2], 0.0, atol=1e-15)


def test_the_weight_of_the_bead_of_the_recording():
    """7.16 fN for 50 kg/m3; the double layer pushes with E / l at contact."""
    weight = Weight(RADIUS, 50.0, [0.0, 0.0, -3.0])
    x = jnp.array([0.0, 0.0, 0.5 + RADIUS])
    np.testing.assert_allclose(weight(0.0, x, x), [0.0, 0.0, -7.16e-3], rtol=1e-3)
    layer = DoubleLayer(0.08, 0.02, RADIUS, FLOOR)
    np.testing.assert_allclose(layer(0.0, x, x), [0.0, 0.0, 4.0])


@pytest.mark.parametrize("height", [0.5, 0.01, -0.01, -2.0])
def test_a_double_layer_pushes_as_its_potential_falls_and_no_more_than_at_contact(
    height,
):
    layer = DoubleLayer(0.08, 0.02, RADIUS, FLOOR)
    x = jnp.array([0.3, 0.0, 0.5 + RADIUS + height])
    push = layer(0.0, x, x)
    slope = jax.grad(lambda x: layer.potential(0.0, x))(x)
    np.testing.assert_allclose(push, -slope, atol=1e-12)
    assert 0 < push[2] <= 4.0


test_values_that_make_no_sense_are_refused = refusals(
    (lambda: Plane([0.0, 0.0]), "Plane.normal: expected a vector that is not zero"),
    (lambda: Plane(1.0), "Plane.normal: expected a point"),
    (lambda: WallMobility(0.0, 1.0, FLOOR), "WallMobility.radius: expected > 0"),
    (lambda: WallMobility(1.0, -1.0, FLOOR), "WallMobility.viscosity: expected"),
    (lambda: Weight(1.0, 50.0, [0.0, 0.0]), "Weight.down: expected a vector that"),
    (lambda: Weight(-1.0, 50.0, [0.0, -1.0]), "Weight.radius: expected > 0"),
    (lambda: DoubleLayer(1.0, 0.0, 1.0, FLOOR), "DoubleLayer.length: expected > 0"),
)
