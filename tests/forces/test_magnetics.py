"""Pulling by a magnetic field that is known as a table."""

import jax.numpy as jnp
import numpy as np
import pytest

from pinav.errors import InputError
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


def table(counts):
    return MagneticFieldTable.sample(dipole, LOWER, UPPER, (counts,) * 3)


def test_the_pull_is_the_gradient_of_the_field_and_converges_with_the_square():
    errors = []
    for count in (9, 17, 33):
        force = DipolePull(table(count), 0.7)(0.0, jnp.asarray(PLACE), jnp.zeros(3))
        errors.append(np.linalg.norm(force - 0.7 * slope(strength, PLACE)))
    assert errors[2] < 2e-3 * 0.7 * np.linalg.norm(slope(strength, PLACE))
    assert errors[2] < errors[0] / 10


def test_a_magnetised_body_is_pulled_by_the_square_of_the_field():
    force = InductionPull(table(33), 0.4)(0.0, jnp.asarray(PLACE), jnp.zeros(3))
    expected = 0.4 * slope(lambda x: strength(x) ** 2 / 2, PLACE)
    np.testing.assert_allclose(force, expected, rtol=3e-3)


def test_a_plane_is_a_table_of_two_axes():
    flat = MagneticFieldTable.sample(
        *(dipole, LOWER[:2], UPPER[:2], (33, 33)), height=PLACE[2]
    )
    np.testing.assert_allclose(
        flat(jnp.asarray(PLACE[:2])), dipole(PLACE[None])[0], rtol=1e-3
    )
    force = DipolePull(flat, 1.0)(0.0, jnp.asarray(PLACE[:2]), jnp.zeros(2))
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
    for place in ([2.5, 2.5], [40.0, -3.0]):
        force = DipolePull(empty, 1.0)(0.0, jnp.array(place), jnp.zeros(2))
        np.testing.assert_array_equal(force, 0.0)
    far = DipolePull(table(9), 1.0)(0.0, jnp.array([9.0, 9.0, 9.0]), jnp.zeros(3))
    np.testing.assert_array_equal(far, 0.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0, 0], [1, 1], np.zeros((5, 5, 2))), "three components at 4 or more points"),
        (([0, 0], [1, 1], np.zeros((5, 3, 3))), "got shape"),
        (([0, 0, 0], [1, 1], np.zeros((5, 5, 3))), "the values have 2 axes"),
    ],
)
def test_what_is_no_table_is_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        MagneticFieldTable(*arguments)


@pytest.mark.parametrize(
    ("field", "upper", "message"),
    [
        (dipole, (0.1, 0.1, 0.1), "expected lower < upper"),
        (lambda x: x * np.nan, UPPER, "keep the region out of the sources"),
        (lambda x: x[:, :2], UPPER, "three finite components"),
    ],
)
def test_a_field_that_cannot_be_sampled_is_refused(field, upper, message):
    with pytest.raises(InputError, match=message):
        MagneticFieldTable.sample(field, LOWER, upper, (5, 5, 5))


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
