import jax
import numpy as np
import pytest
from tests.refusals import refusals

from pinav.analysis import helmholtz_split, rotational_fractions, sample_forces
from pinav.evaluation import FieldMap
from pinav.fitting import Posterior, ravel_model
from pinav.scenarios import barrier_crossings

AXIS = np.linspace(-6.0, 6.0, 41)
GRID = np.stack(np.meshgrid(AXIS, AXIS), axis=-1)


def gaussian(height, center, width):
    """A Gaussian and its slope."""
    offset = (GRID - np.array(center)) / width
    value = height * np.exp(-0.5 * (offset**2).sum(axis=-1))
    return value, -value[..., None] * offset / width


POTENTIAL, SLOPE = gaussian(3.0, (0.0, 0.0), 2.0)
STREAM, STREAM_SLOPE = gaussian(2.0, (1.0, -1.0), 1.7)
GRADIENT = -SLOPE
SWIRL = np.stack([STREAM_SLOPE[..., 1], -STREAM_SLOPE[..., 0]], axis=-1)


EVERYWHERE = np.zeros(GRID.shape[:2])


ANGLES = np.array([0.3, 1.1, 2.0, 2.7])
NORMALS = np.stack([np.cos(ANGLES), np.sin(ANGLES)])
NEAR_PATHS = np.abs(GRID @ NORMALS - [0.4, -0.8, 1.5, 0.1]).min(axis=-1)
"""Distance from a few chords: the ground has holes and a ragged edge."""


def split(force, distance=EVERYWHERE):
    return helmholtz_split(FieldMap(AXIS, AXIS, force, distance))


@pytest.mark.parametrize(
    "distance", [EVERYWHERE, NEAR_PATHS], ids=["everywhere", "near paths"]
)
def test_fractions_of_closed_forms(distance):
    potential, stream, both = (
        split(force, distance) for force in (GRADIENT, SWIRL, GRADIENT + SWIRL)
    )
    assert potential.rotational_fraction < 1e-3
    assert potential.least_fraction < 1e-6
    assert stream.rotational_fraction > 0.999
    assert stream.greatest_fraction > 1 - 1e-6
    squares = [(part[both.region] ** 2).sum() for part in (GRADIENT, SWIRL)]
    true = squares[1] / sum(squares)
    assert both.rotational_fraction == pytest.approx(true, rel=0.01)
    assert both.gradient_fraction == 1.0 - both.rotational_fraction
    assert both.least_fraction <= true <= both.greatest_fraction
    assert both.misfit < 1e-3
    assert np.allclose(both.gradient[both.region], GRADIENT[both.region], atol=0.02)


def test_potential_is_found_up_to_a_constant():
    found = split(GRADIENT + SWIRL)
    assert found.potential.min() == 0.0
    assert np.ptp(found.potential - POTENTIAL) < 0.03
    assert np.ptp(found.stream - STREAM) < 0.03


def test_a_constant_force_is_ambiguous():
    found = split(np.ones_like(GRID))
    assert found.least_fraction < 1e-3
    assert found.greatest_fraction > 0.999
    assert 0.05 < found.rotational_fraction < 0.95


def test_what_lies_far_from_the_data_has_no_say():
    wild = np.where((NEAR_PATHS > 1.0)[..., None], 1e3, GRADIENT)
    assert split(wild, NEAR_PATHS).rotational_fraction < 1e-3


def test_the_split_does_not_depend_on_rounding():
    """On coarse grids kernels lie just within reach of the samples, or just beyond."""
    x, y = np.linspace(-0.5, 22.7, 15), np.linspace(-6.0, 17.2, 15)
    points = np.stack(np.meshgrid(x, y), axis=-1)
    force = np.stack([np.cos(points[..., 1] / 3), np.sin(points[..., 0] / 4)], axis=-1)
    distance = np.where(np.abs(points[..., 0] - points[..., 1]) < 4.0, 0.0, np.inf)
    fields = [
        FieldMap(x + shift, y - shift, force, distance)
        for shift in 1e-12 * np.arange(-5, 6)
    ]
    assert len({round(helmholtz_split(f).rotational_fraction, 6) for f in fields}) == 1


def test_fractions_of_samples_are_those_of_each():
    forces = np.stack([GRADIENT, SWIRL, GRADIENT - SWIRL])
    each = [split(force, NEAR_PATHS).rotational_fraction for force in forces]
    field = FieldMap(AXIS, AXIS, GRADIENT, NEAR_PATHS)
    assert np.allclose(rotational_fractions(field, forces), each, atol=1e-9)


def test_sampled_forces_have_the_posterior_s_mean_and_spread():
    swimmer = barrier_crossings().truth
    free, theta = ravel_model(swimmer, lambda m: m.environment.height)
    posterior = Posterior(free, np.asarray(theta), np.array([[0.04]]))
    axis = np.linspace(3.0, 8.0, 3)
    grid = FieldMap(axis, axis, np.zeros((3, 3, 2)), np.zeros((3, 3)))
    forces = sample_forces(posterior, grid, 400, key=jax.random.key(0))
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    sd = posterior.force_sd(points).reshape(3, 3, 2)
    assert np.allclose(forces.std(axis=0), sd, rtol=0.15)
    assert forces.shape == (400, 3, 3, 2)


test_bad_fields_are_refused = refusals(
    (lambda: split(GRADIENT, EVERYWHERE + 5.0), "no finite force within 1 of a sample"),
    (lambda: split(np.zeros_like(GRADIENT)), "the force is zero near the data"),
)
