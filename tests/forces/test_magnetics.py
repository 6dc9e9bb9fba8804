"""Pulling by a magnetic field that is known as a table."""

import jax.numpy as jnp
import numpy as np
import pytest
from tests.refusals import refusals

from pinav.forces import DipolePull, InductionPull, MagneticFieldTable

MOMENT = np.array([0.0, 0.0, 3.0])
LOWER, UPPER = (0.6, 0.5, 0.7), (1.4, 1.5, 1.5)
PLACE = np.array([1.05, 0.93, 1.12])


def dipole(places):
    """Field of a dipole at the origin, without the factor of the vacuum."""
    r = np.linalg.norm(places, axis=1, keepdims=True)
    n = places / r
    return (3 * n * (n @ MOMENT)[:, None] - MOMENT) / r**3


def slope(function, place, step=1e-5):
    """Gradient by differences."""
    ends = [[function(place + s * step * e) for s in (1, -1)] for e in np.eye(3)]
    return np.array([(a - b) / (2 * step) for a, b in ends])


def strength(place):
    return np.linalg.norm(dipole(place[None])[0])


def table(count):
    return MagneticFieldTable.sample(dipole, LOWER, UPPER, (count,) * 3)


def force_of(kind, field, size, place=PLACE):
    at = jnp.asarray(place)
    return kind(field, size)(0.0, at, jnp.zeros_like(at))


def test_the_pull_is_the_gradient_of_the_field_and_converges_with_the_square():
    expected = 0.7 * slope(strength, PLACE)
    coarse, fine = (
        np.linalg.norm(force_of(DipolePull, table(count), 0.7) - expected)
        for count in (9, 33)
    )
    assert fine < 2e-3 * np.linalg.norm(expected)
    assert fine < coarse / 10


def test_a_magnetised_body_is_pulled_by_the_square_of_the_field():
    expected = 0.4 * slope(lambda x: strength(x) ** 2 / 2, PLACE)
    found = force_of(InductionPull, table(33), 0.4)
    np.testing.assert_allclose(found, expected, rtol=3e-3)


def test_a_plane_is_a_table_of_two_axes():
    flat = MagneticFieldTable.sample(
        *(dipole, LOWER[:2], UPPER[:2], (33, 33)), height=PLACE[2]
    )
    field = flat(jnp.asarray(PLACE[:2]))
    np.testing.assert_allclose(field, dipole(PLACE[None])[0], rtol=1e-3)
    force = force_of(DipolePull, flat, 1.0, PLACE[:2])
    np.testing.assert_allclose(force, slope(strength, PLACE)[:2], rtol=5e-3)


def test_lengths_may_be_in_another_unit():
    micro = MagneticFieldTable.sample(
        *(dipole, np.multiply(LOWER, 1e6), np.multiply(UPPER, 1e6), (9, 9, 9)),
        metre=1e6,
    )
    np.testing.assert_allclose(
        micro(jnp.asarray(PLACE * 1e6)), table(9)(jnp.asarray(PLACE)), rtol=1e-9
    )


def test_without_a_field_and_beyond_the_table_nothing_pulls():
    empty = MagneticFieldTable([0, 0], [1, 1], np.zeros((5, 5, 3)))
    for field, place in (
        (empty, [2.5, 2.5]),
        (empty, [40.0, -3.0]),
        (table(9), [9.0, 9.0, 9.0]),
    ):
        assert not force_of(DipolePull, field, 1.0, place).any()


def table_over(lower, *shape):
    return lambda: MagneticFieldTable(lower, [1, 1], np.zeros(shape))


def sampled(field, upper=UPPER):
    return lambda: MagneticFieldTable.sample(field, LOWER, upper, (5, 5, 5))


test_what_is_no_table_is_refused = refusals(
    (table_over([0, 0], 5, 5, 2), "three components at 4 or more points"),
    (table_over([0, 0], 5, 3, 3), "got shape"),
    (table_over([0, 0, 0], 5, 5, 3), "the values have 2 axes"),
    (sampled(dipole, (0.1, 0.1, 0.1)), "expected lower < upper"),
    (sampled(lambda x: x * np.nan), "keep the region out of the sources"),
    (sampled(lambda x: x[:, :2]), "three finite components"),
)


@pytest.mark.extras("magpylib")
def test_the_pull_of_a_magnet_is_that_of_magpylib():
    """magpylib: the force on a dipole that points along the field."""
    import magpylib

    magnet = magpylib.magnet.Cuboid(
        dimension=(2e-3, 2e-3, 4e-3), polarization=(0, 0, 1.2)
    )
    lower, upper = np.array([1500.0, -800, 3000]), np.array([3100.0, 800, 4600])
    known = MagneticFieldTable.sample(
        magnet.getB, lower, upper, (33, 33, 33), metre=1e6
    )
    place = np.array([2310.0, 130, 3770])
    field = magnet.getB(place / 1e6)
    np.testing.assert_allclose(known(jnp.asarray(place)), field, rtol=1e-5)
    moment = 2e-9 * field / np.linalg.norm(field)
    target = magpylib.misc.Dipole(position=place / 1e6, moment=moment)
    newton, _ = magpylib.getFT(magnet, target)
    pull = DipolePull(known, 2e-9)(0.0, jnp.asarray(place), jnp.zeros(3))
    # The gradient is per micrometre.
    np.testing.assert_allclose(1e6 * np.asarray(pull), np.ravel(newton), rtol=2e-3)
