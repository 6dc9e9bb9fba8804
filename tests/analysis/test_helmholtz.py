import jax
import numpy as np
import pytest

from pinav.analysis import helmholtz_split, rotational_fractions, sample_forces
from pinav.errors import InputError
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


def everywhere():
    return np.zeros(GRID.shape[:2])


def near_paths():
    """Distance from a few chords: the ground has holes and a ragged edge."""
    angles = np.array([0.3, 1.1, 2.0, 2.7])
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    offsets = np.array([0.4, -0.8, 1.5, 0.1])
    return np.abs(GRID @ normals.T - offsets).min(axis=-1)


GROUNDS = {"everywhere": everywhere, "near paths": near_paths}


@pytest.mark.parametrize("distance", GROUNDS.values(), ids=GROUNDS)
def test_fractions_of_closed_forms(distance):
    distance = distance()

    def split(force):
        return helmholtz_split(FieldMap(AXIS, AXIS, force, distance))

    assert split(GRADIENT).rotational_fraction < 1e-3
    assert split(GRADIENT).least_fraction < 1e-6
    assert split(SWIRL).rotational_fraction > 0.999
    assert split(SWIRL).greatest_fraction > 1 - 1e-6
    both = split(GRADIENT + SWIRL)
    squares = [(part[both.region] ** 2).sum() for part in (GRADIENT, SWIRL)]
    true = squares[1] / sum(squares)
    assert both.rotational_fraction == pytest.approx(true, rel=0.01)
    assert both.gradient_fraction == 1.0 - both.rotational_fraction
    assert both.least_fraction <= true <= both.greatest_fraction
    assert both.misfit < 1e-3
    assert np.allclose(both.gradient[both.region], GRADIENT[both.region], atol=0.02)


def test_potential_is_found_up_to_a_constant():
    found = helmholtz_split(FieldMap(AXIS, AXIS, GRADIENT + SWIRL, everywhere()))
    assert found.potential.min() == 0.0
    assert np.ptp(found.potential - POTENTIAL) < 0.03
    assert np.ptp(found.stream - STREAM) < 0.03


def test_a_constant_force_is_ambiguous():
    constant = np.ones_like(GRID)
    found = helmholtz_split(FieldMap(AXIS, AXIS, constant, everywhere()))
    assert found.least_fraction < 1e-3
    assert found.greatest_fraction > 0.999
    assert 0.05 < found.rotational_fraction < 0.95


def test_what_lies_far_from_the_data_has_no_say():
    distance = near_paths()
    wild = np.where((distance > 1.0)[..., None], 1e3, GRADIENT)
    found = helmholtz_split(FieldMap(AXIS, AXIS, wild, distance))
    assert found.rotational_fraction < 1e-3


def test_the_split_does_not_depend_on_rounding():
    """On coarse grids kernels lie just within reach of the samples, or just beyond."""
    axes = [np.linspace(-0.5, 22.7, 15), np.linspace(-6.0, 17.2, 15)]
    points = np.stack(np.meshgrid(*axes), axis=-1)
    force = np.stack([np.cos(points[..., 1] / 3), np.sin(points[..., 0] / 4)], axis=-1)
    distance = np.where(np.abs(points[..., 0] - points[..., 1]) < 4.0, 0.0, np.inf)
    fractions = {
        round(
            helmholtz_split(
                FieldMap(axes[0] + shift, axes[1] - shift, force, distance)
            ).rotational_fraction,
            6,
        )
        for shift in 1e-12 * np.arange(-5, 6)
    }
    assert len(fractions) == 1


def test_fractions_of_samples_are_those_of_each():
    field = FieldMap(AXIS, AXIS, GRADIENT, near_paths())
    forces = np.stack([GRADIENT, SWIRL, GRADIENT - SWIRL])
    each = [
        helmholtz_split(FieldMap(AXIS, AXIS, force, field.distance)) for force in forces
    ]
    fractions = rotational_fractions(field, forces)
    assert np.allclose(fractions, [one.rotational_fraction for one in each], atol=1e-9)


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


def test_bad_fields_are_refused():
    field = FieldMap(AXIS, AXIS, GRADIENT, everywhere() + 5.0)
    with pytest.raises(InputError, match="no finite force within 1 of a sample"):
        helmholtz_split(field)
    zero = FieldMap(AXIS, AXIS, np.zeros_like(GRADIENT), everywhere())
    with pytest.raises(InputError, match="the force is zero near the data"):
        helmholtz_split(zero)
