import jax.numpy as jnp
import numpy as np
import pytest
import sympy

from pinav.analysis.discovery.candidates import POTENTIALS, ROTATIONS
from pinav.errors import InputError
from pinav.forces import GaussianBarrier
from pinav.forces.formulas import Role
from pinav.forces.geometries import Center, Ellipse, Line
from pinav.forces.law_force import LawForce
from pinav.forces.law_library import (
    ANISOTROPIC_TRAP,
    CHANNEL,
    GAUSSIAN,
    GAUSSIAN_SWIRL,
    HARMONIC,
    LATTICES,
    PLANE_WAVE,
    RING,
    SADDLE,
    WALL,
    profile_laws,
    turn,
)
from pinav.forces.laws import ProfileLaw, SumLaw, Turned, expressions, latex, sympy_text
from pinav.forces.profiles import CompactHill, Gaussian, InversePower, Lorentzian

SWIRL = GAUSSIAN_SWIRL
STRUCTURED = (
    ProfileLaw(Gaussian(), Line()),
    ProfileLaw(InversePower(), Ellipse()),
    ProfileLaw(Lorentzian(), Center(count=3)),
    *LATTICES[1:],
    ANISOTROPIC_TRAP,
)
TURNING = (*ROTATIONS, turn(profile_laws(Center())[-1]), turn(PLANE_WAVE))
LAWS = (*POTENTIALS, *STRUCTURED, *TURNING, GAUSSIAN + GAUSSIAN, GAUSSIAN + SWIRL)
IDS = [law.name for law in LAWS]
POINTS = jnp.array([[0.3, -0.7], [1.9, 2.2], [-1.1, 0.4]])


def constants_of(law):
    """Values that no symmetry makes special."""
    return jnp.linspace(0.7, 1.9, len(law.constants))


def force_at(law, constants, x):
    return LawForce(law, constants)(0.0, x, jnp.zeros(2))


@pytest.mark.parametrize("law", LAWS, ids=IDS)
def test_formula_and_force_agree(law):
    constants = constants_of(law)
    formula = sympy.sympify(sympy_text(law, np.asarray(constants)))
    x, y = sympy.symbols("x y")
    for point in POINTS:
        at = {x: float(point[0]), y: float(point[1])}
        expected = [float(part.subs(at)) for part in formula]
        np.testing.assert_allclose(
            force_at(law, constants, point), expected, rtol=1e-6, atol=1e-7
        )


@pytest.mark.parametrize("law", LAWS, ids=IDS)
def test_latex_names_every_constant(law):
    formulas = expressions(law)
    text = latex(law)
    assert {*formulas.symbols} == {"x", "y", *(own.name for own in law.constants)}
    for own in law.constants:
        assert sympy.latex(formulas.symbols[own.name]) in text


@pytest.mark.parametrize("law", LAWS, ids=IDS)
def test_amplitudes_are_linear(law):
    chosen = np.array(law.indices(Role.AMPLITUDE))
    constants = constants_of(law)
    doubled = constants.at[chosen].multiply(2.0)
    np.testing.assert_allclose(
        force_at(law, doubled, POINTS[0]),
        2.0 * force_at(law, constants, POINTS[0]),
        rtol=1e-12,
    )


def test_gaussian_law_is_the_barrier():
    barrier = GaussianBarrier(height=5.25, center=[5.0, 4.0], width=2.9)
    law = LawForce(GAUSSIAN, jnp.array([5.25, 5.0, 4.0, 2.9]))
    x = jnp.array([3.0, 6.0])
    np.testing.assert_allclose(law(0.0, x, x), barrier(0.0, x, x), rtol=1e-12)


def test_sum_adds_forces_and_numbers_shared_names():
    law = GAUSSIAN + SWIRL
    a, b = constants_of(GAUSSIAN), constants_of(SWIRL)
    np.testing.assert_allclose(
        force_at(law, jnp.concatenate([a, b]), POINTS[0]),
        force_at(GAUSSIAN, a, POINTS[0]) + force_at(SWIRL, b, POINTS[0]),
        rtol=1e-12,
    )
    names = [own.name for own in law.constants]
    assert names[:3] == ["height", "center_x_1", "center_y_1"]
    assert "strength" in names
    assert len(set(names)) == len(names)
    assert law == SumLaw((GAUSSIAN, SWIRL))


@pytest.mark.parametrize(
    ("law", "special"),
    [
        (ProfileLaw(InversePower(), Center()), ProfileLaw(Lorentzian(), Center())),
        (ProfileLaw(Gaussian(), Ellipse()), GAUSSIAN),
        (ProfileLaw(InversePower(), Ellipse()), ProfileLaw(Lorentzian(), Center())),
        (RING, GAUSSIAN),
        (CHANNEL, WALL),
        (ANISOTROPIC_TRAP, SADDLE),
        (LATTICES[1], LATTICES[0]),
        (LATTICES[0], PLANE_WAVE),
        (Turned(RING), GAUSSIAN_SWIRL),
        (GAUSSIAN + SWIRL, SWIRL),
        (WALL + RING, GAUSSIAN + WALL),
        (GAUSSIAN + WALL + SADDLE, SADDLE + GAUSSIAN),
    ],
    ids=lambda law: law.name,
)
def test_a_law_contains_its_special_cases(law, special):
    assert law.contains(special)
    assert not special.contains(law)
    assert not law.contains(law)


def test_laws_that_are_no_special_cases_are_not_contained():
    assert not GAUSSIAN.contains(HARMONIC)
    assert not RING.contains(WALL)
    assert not (GAUSSIAN + WALL).contains(GAUSSIAN + SADDLE)
    assert not (GAUSSIAN + SWIRL).contains(RING)
    assert not SWIRL.contains(GAUSSIAN)


def test_an_inverse_power_is_its_special_case_for_its_exponent():
    constants = jnp.array([2.0, 1.0, 0.0, 1.5])
    power = ProfileLaw(InversePower(), Center())
    np.testing.assert_allclose(
        force_at(power, jnp.append(constants, 2.0), POINTS[1]),
        force_at(ProfileLaw(Lorentzian(), Center()), constants, POINTS[1]),
        rtol=1e-12,
    )


@pytest.mark.parametrize(
    "law",
    [*profile_laws(Center()), *map(turn, profile_laws(Center()))],
    ids=lambda law: law.name,
)
def test_forces_are_finite_at_a_centre(law):
    constants = constants_of(law)
    names = [constant.name for constant in law.constants]
    center = [constants[names.index(f"center_{axis}")] for axis in "xy"]
    assert np.all(np.isfinite(force_at(law, constants, jnp.stack(center))))


def test_a_compact_hill_ends():
    law = ProfileLaw(CompactHill(), Center())
    constants = jnp.array([2.0, 0.0, 0.0, 1.5, 3.0])
    np.testing.assert_array_equal(force_at(law, constants, jnp.array([1.6, 0.0])), 0.0)
    inside = force_at(law, constants, jnp.array([1.0, 0.0]))
    expected = 2.0 * 3.0 * (1 - 1 / 2.25) ** 2 * 2 / 2.25
    np.testing.assert_allclose(inside, [expected, 0.0], rtol=1e-12)


def test_wrong_number_of_constants_is_refused():
    with pytest.raises(
        InputError, match=r"Gaussian expects shape \(4,\) .*, got \(3,\)"
    ):
        LawForce(GAUSSIAN, jnp.ones(3))
