"""The variance of the force where kernels were not laid, against kernels that are."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.forces import (
    CentralTerm,
    KernelForce,
    KernelMixture,
    KernelPotential,
    KernelStream,
    StructuredForce,
    forces_at,
    kernel_centers,
    kernels,
)
from pinav.forces.kernels import KernelGaps

SPACING, WIDTH = 0.7, 0.7
AROUND = np.array([[0.0, 0.0], [1.0, 0.4]])
CENTERS = kernel_centers(AROUND, spacing=SPACING, margin=2.8)
FAR = np.array([[40.0, 3.0], [-25.0, 8.0]])
SHAPE = np.array([0.6, 3.5, 0.3, -0.2])


def lattice(place):
    """All kernels of the grid of `CENTERS` that reach a place."""
    nearest = CENTERS[0] + SPACING * np.round((place - CENTERS[0]) / SPACING)
    side = SPACING * np.arange(-7, 8)
    return nearest + np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)


def explicit_variance(kind, place):
    """Of a force whose kernels are laid at the place, by the prior of `CENTERS`."""
    centers = lattice(place)
    both = np.concatenate([CENTERS, centers])
    # the shape counts from the middle of the kernels that there are
    middle = (CENTERS.min(axis=0) + CENTERS.max(axis=0)) / 2
    moved = (both.min(axis=0) + both.max(axis=0)) / 2
    shape = SHAPE + np.append([0.0, 0.0], (middle - moved) / WIDTH)
    force = kind.with_zero_weights(both, WIDTH)
    covariance = force.prior().covariance(shape)

    def at(weights):
        return kind(weights, force.centers, force.width)(
            0.0, jnp.asarray(place), jnp.zeros(2)
        )

    rows = np.asarray(jax.jacobian(at)(force.weights)).reshape(2, -1)
    return np.diag(rows @ covariance @ rows.T)


@pytest.mark.parametrize("kind", [KernelForce, KernelPotential, KernelStream])
def test_it_is_that_of_the_prior_far_from_all_kernels_and_nothing_among_the_data(kind):
    force = kind.with_zero_weights(CENTERS, WIDTH)
    variance = force.variance_beyond(SHAPE, FAR)
    expected = [explicit_variance(kind, place) for place in FAR]
    np.testing.assert_allclose(variance, expected, rtol=1e-3)
    assert variance.min() > 0
    there = force.variance_beyond(SHAPE, AROUND)
    assert np.sqrt(there.max() / variance.max()) < 5e-3


MIXTURE = KernelMixture.with_zero_weights(CENTERS, WIDTH)
TERM = CentralTerm(jnp.zeros(5), jnp.zeros(2), jnp.arange(0.5, 5.0), 1.0)
BESIDE = StructuredForce((TERM,), MIXTURE.gradient)
BESIDE_SHAPE = np.concatenate([TERM.prior().start, SHAPE, [-1.0]])
BESIDE_RATIO = BESIDE.prior().unit * np.exp(-1.0)


def test_parts_add_with_their_own_shapes_and_ratio():
    other = SHAPE + np.array([0.4, 0.0, 0.0, 0.0])
    both = MIXTURE.variance_beyond(np.concatenate([SHAPE, other, [-0.5]]), FAR)
    expected = MIXTURE.gradient.variance_beyond(SHAPE, FAR)
    rotation = MIXTURE.rotation.variance_beyond(other, FAR)
    np.testing.assert_allclose(both, expected + np.exp(-1.0) * rotation)
    beside = BESIDE.variance_beyond(BESIDE_SHAPE, FAR)
    np.testing.assert_allclose(beside, BESIDE_RATIO**2 * expected)


def test_kernels_on_no_grid_have_no_gaps():
    places = np.random.default_rng(0).uniform(size=(9, 2))
    assert KernelGaps.of(places, 0.1) is None
    assert KernelGaps.of(places[:1], 0.1) is None
    force = KernelForce.with_zero_weights(places, 0.1)
    assert not force.variance_beyond(SHAPE, FAR).any()
    assert force.draw_beyond(SHAPE, 1.0, np.random.default_rng(0)) == []


def test_filled_places_are_not_missing():
    gaps = KernelGaps.of(CENTERS, WIDTH)
    places, is_missing = gaps.about(CENTERS[:3])
    gap = np.linalg.norm(places[:, :, None] - CENTERS, axis=-1).min(axis=-1)
    np.testing.assert_array_equal(is_missing, gap > 0.5 * SPACING)


def test_draws_of_missing_kernels_have_the_variance_beyond():
    around = np.array([[0.0, 0.0], [7.0, 0.0], [0.0, 7.0]])
    centers = kernel_centers(around, spacing=SPACING, margin=2.8)
    force = KernelPotential.with_zero_weights(centers, WIDTH)
    inside = np.array([[6.5, 6.9], [3.0, 5.0], [0.0, 7.0]])
    generator = np.random.default_rng(0)
    drawn = [force.draw_beyond(SHAPE, 1.7, generator)[0] for _ in range(150)]
    forces = np.array([forces_at(one, np.zeros(3), inside) for one in drawn])
    expected = 1.7 * np.sqrt(force.variance_beyond(SHAPE, inside))
    np.testing.assert_allclose(forces.std(axis=0), expected, rtol=0.2, atol=0.04)
    assert expected[:2].min() > 0.2


def test_missing_kernels_and_those_that_there_are_fill_the_box():
    missing = KernelGaps.of(CENTERS, WIDTH).in_box()
    both = np.concatenate([CENTERS, missing])
    sides = np.round(np.ptp(CENTERS, axis=0) / SPACING).astype(int) + 1
    assert len(both) == sides.prod()
    assert len(np.unique(np.round(both / SPACING, 3), axis=0)) == len(both)


def test_parts_are_drawn_with_their_own_amplitude():
    shape = np.concatenate([SHAPE, SHAPE, [-0.5]])
    parts = MIXTURE.draw_beyond(shape, 2.0, np.random.default_rng(1))
    assert [type(part) for part in parts] == [KernelPotential, KernelStream]
    ratio = np.std(parts[1].weights) / np.std(parts[0].weights)
    assert ratio == pytest.approx(np.exp(-0.5), rel=0.5)
    (rest,), (same,) = (
        force.draw_beyond(shape, amplitude, np.random.default_rng(1))
        for force, shape, amplitude in (
            (BESIDE, BESIDE_SHAPE, 1.0),
            (MIXTURE.gradient, SHAPE, BESIDE_RATIO),
        )
    )
    np.testing.assert_array_equal(rest.weights, same.weights)


def test_more_missing_kernels_than_a_map_bears_are_not_drawn(monkeypatch):
    force = KernelForce.with_zero_weights(CENTERS, WIDTH)
    count = len(KernelGaps.of(CENTERS, WIDTH).in_box())
    generator = np.random.default_rng(0)
    monkeypatch.setattr(kernels, "MOST_DRAWN", count)
    assert len(force.draw_beyond(SHAPE, 1.0, generator)[0].centers) == count
    monkeypatch.setattr(kernels, "MOST_DRAWN", count - 1)
    assert force.draw_beyond(SHAPE, 1.0, generator) == []
