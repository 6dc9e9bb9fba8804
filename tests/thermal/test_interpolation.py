"""Weights between centres, flux-weighted at jumps; balls by their radius."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pinav.thermal.grids import (
    CartesianGrid,
    RadialGrid,
    ResistanceScale,
    linear_weights,
)
from pinav.thermal.perfusion import BLEND, lang

EDGES = np.linspace(0.0, 1.0, 11)


def cells_cut_at(place, inside, outside):
    """Conductivity of cells of which one is cut, harmonic by volume."""
    share = np.clip((place - EDGES[:-1]) / np.diff(EDGES), 0.0, 1.0)
    return 1 / (share / inside + (1 - share) / outside)


@given(st.floats(0.15, 0.85), st.floats(0.2, 2.0), st.floats(0.06, 0.94))
def test_a_constant_flux_through_two_materials_is_reproduced(place, inside, x):
    def temperature(at):
        return np.minimum(at, place) / inside + np.maximum(at - place, 0.0) / 0.5

    scale = ResistanceScale.of(EDGES, cells_cut_at(place, inside, 0.5))
    # a cell's temperature is that of the middle of its resistance
    weights = linear_weights(scale.at(x), scale.values)
    assert weights @ scale.values == pytest.approx(temperature(x), abs=1e-9)
    assert weights.sum() == pytest.approx(1.0)


@given(st.floats(0.0, 1.0))
def test_one_material_is_interpolated_in_the_distance(x):
    centers = 0.5 * (EDGES[1:] + EDGES[:-1])
    scale = ResistanceScale.of(EDGES, np.full(10, 0.37))
    weights = linear_weights(scale.at(x), scale.values)
    assert np.allclose(weights, linear_weights(x, centers), atol=1e-9)


def test_a_box_weights_each_axis_by_the_line_of_cells_through_the_point():
    grid = CartesianGrid.cubes((10, 4), 0.1)
    k = cells_cut_at(0.5, 0.2, 0.8)[:, None] * np.ones(4)
    along = ResistanceScale.of(EDGES, k[:, 0])
    weights = np.asarray(grid.interpolation([[0.52, 0.2]], k)[0])
    line = linear_weights(along.at(0.52), along.values)
    assert np.allclose(weights.sum(axis=1), line)
    assert np.allclose(weights.sum(axis=0), [0.0, 0.5, 0.5, 0.0])


@pytest.mark.parametrize("share", [0.0, 1e-9, -1e-9, 0.3, 0.5])
@pytest.mark.parametrize("make", [RadialGrid.slab, RadialGrid.sphere])
def test_a_radius_moves_a_shell_of_its_area(make, share):
    grid = make(0.05, 50)
    radius = 1e-3 * (10 + share)
    moved = jax.jacfwd(grid.ball)(jnp.asarray(radius)) * grid.volumes
    area = (1.0 if grid.exponent == 0 else 4 * np.pi) * radius**grid.exponent
    assert float(moved.sum()) == pytest.approx(area)
    assert float(moved @ grid.centers) == pytest.approx(area * radius)
    assert int((np.abs(moved) > 1e-6 * area).sum()) <= 2


def test_a_ball_of_no_radius_or_beyond_the_grid_does_not_move():
    grid = RadialGrid.sphere(0.05, 10)
    assert not jax.jacfwd(grid.ball)(jnp.asarray(0.06)).any()
    assert not jax.jacfwd(grid.ball)(jnp.asarray(0.0)).any()
    assert jax.jacfwd(lambda end: RadialGrid.sphere(end, 10).ball(0.02))(0.05).any()


def test_the_law_of_tumours_does_not_jump():
    at = jnp.linspace(41.5, 42.5, 2001)
    values = lang("tumour")(at)
    slopes = jax.grad(lambda t: lang("tumour")(t).sum())(at)
    assert float(jnp.abs(jnp.diff(values)).max()) < 2e-4
    assert jnp.allclose(slopes.sum() * 5e-4, values[-1] - values[0], rtol=1e-2)
    assert float(lang("tumour")(jnp.asarray([42.0 + BLEND]))[0]) == 0.416
