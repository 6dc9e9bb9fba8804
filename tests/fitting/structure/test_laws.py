import numpy as np
import pytest
from tests.fitting.structure.observed_forces import observed_forces

from pinav.fitting.structure.laws import follow_laws
from pinav.fitting.structure.starts import Region, central_term, linear_term, wall_term
from pinav.fitting.structure.trials import with_profiles
from pinav.forces import (
    LinearForce,
    PlaneWaves,
    SumForce,
    compact_hill,
    power_hill,
    ring_barrier,
    soft_wall,
)
from pinav.forces.fitted_numbers import SIZE
from pinav.forces.geometries import Center
from pinav.forces.law_force import force_of
from pinav.forces.laws import ProfileLaw
from pinav.forces.profiles import DISTANCES, FITTED, PROFILES

POINTS = np.random.default_rng(1).uniform(0.0, 10.0, (1, 150, 2))
REGION = Region.of(POINTS[0])
CENTER, NOISE = [4.0, 6.0], 0.003
SLOW = pytest.mark.slow


def lawful(truth, *starts):
    """The last term of the structure that follows laws."""
    data = observed_forces(truth, POINTS, NOISE)
    made = follow_laws(with_profiles(starts, data), data, REGION, NOISE)
    return None if made is None else made.terms[-1]


@pytest.mark.parametrize(
    ("truth", "tail", "size"),
    [
        pytest.param(power_hill(3.0, CENTER, 1.5, 0.5), 2.0, 1.5, marks=SLOW),
        (power_hill(3.0, CENTER, 1.5, 1.0), 1.0, 1.5 / np.sqrt(2)),
        (compact_hill(-3.0, CENTER, 4.0), -1 / 3, 4.0 / np.sqrt(6)),
    ],
)
def test_a_hill_has_the_tail_and_size_of_the_true_one(truth, tail, size):
    term = lawful(truth, central_term(REGION, np.array([4.05, 5.97])))
    assert term.law.name == "hill"
    constants = term.law.constants()
    np.testing.assert_allclose(constants["tail"], tail, atol=0.1)
    np.testing.assert_allclose(constants["size"], size, rtol=0.03)
    np.testing.assert_allclose(term.center, CENTER, atol=0.02)


def test_a_ring_and_a_wall_follow_their_laws():
    ring = lawful(
        ring_barrier(2.0, CENTER, 3.0, 0.8), central_term(REGION, np.array([4.0, 6.0]))
    )
    assert ring.law.name == "ring"
    np.testing.assert_allclose(ring.law.constants()["radius"], 3.0, atol=0.02)
    wall = lawful(soft_wall(4.0, 0.7, 7.0, 0.8), wall_term(REGION, 0.7))
    assert wall.law.name == "step"
    np.testing.assert_allclose(wall.law.constants()["size"], 0.8, rtol=0.05)


@SLOW
def test_the_law_of_a_wide_ring_does_not_vanish_at_its_centre():
    truth = ring_barrier(2.0, CENTER, 1.8, 1.0)
    ring = lawful(truth, central_term(REGION, np.array([4.02, 5.98])))
    assert ring.law.name == "ring"
    np.testing.assert_allclose(ring.law.constants()["radius"], 1.8, atol=0.02)
    np.testing.assert_allclose(ring.law.constants()["size"], 1.0, rtol=0.02)


def test_a_ring_narrower_than_its_flank_is_no_law():
    """It would be one of any hill whose formula is not among the laws."""
    truth = ring_barrier(2.0, CENTER, 0.6, 1.0)
    hill = lawful(truth, central_term(REGION, np.array([4.02, 5.98])))
    assert hill is None or hill.law.name != "ring"


@pytest.mark.parametrize(
    "period", [2.5, pytest.param(4.0, marks=SLOW), pytest.param(9.0, marks=SLOW)]
)
def test_stripes_follow_a_wave_of_their_period(period):
    along = 2 * np.pi / period * np.array([[np.cos(0.7), np.sin(0.7)]])
    wave = lawful(PlaneWaves([1.5], along, [0.4]), wall_term(REGION, 0.7))
    assert wave.law.name == "wave"
    np.testing.assert_allclose(wave.law.constants()["period"], period, rtol=0.01)


@SLOW
def test_the_law_of_a_term_in_a_sum_is_found():
    saddle = LinearForce(np.array([[0.2, 0.05], [0.05, -0.2]]), [5.0, 5.0])
    truth = SumForce((power_hill(3.0, CENTER, 1.5, 1.0), saddle))
    centre = central_term(REGION, np.array([4.03, 6.02]))
    term = lawful(truth, linear_term(REGION), centre)
    assert term.law.name == "hill"
    np.testing.assert_allclose(term.law.constants()["tail"], 1.0, atol=0.15)


def test_a_profile_that_follows_no_law_keeps_its_kernels():
    """Two rings of opposite sign about one centre."""
    truth = SumForce(
        (ring_barrier(2.0, CENTER, 3.0, 0.6), ring_barrier(-2.0, CENTER, 1.2, 0.4))
    )
    centre = central_term(REGION, np.array([4.0, 6.0]))
    assert lawful(truth, centre) is None


def test_a_new_profile_needs_no_entry_elsewhere(monkeypatch):
    """Its words are no others': a fit walks the numbers that it states."""

    class Screened(type(PROFILES["Yukawa"])):
        fitted_in = (DISTANCES,)
        numbers = (SIZE._replace(name="core"), SIZE._replace(name="range"))

    monkeypatch.setitem(FITTED, "screened", Screened())
    term = lawful(
        force_of(ProfileLaw(Screened(), Center()), 3.0, *CENTER, 0.4, 1.0),
        central_term(REGION, np.array([4.05, 5.97])),
    )
    assert term.law.name == "screened"
    np.testing.assert_allclose(term.law.constants()["range"], 1.0, rtol=0.05)
    assert r"\lambda" in term.law.latex
