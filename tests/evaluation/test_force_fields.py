import equinox as eqx
import jax
import numpy as np
import pytest

from pinav.errors import InputError
from pinav.evaluation import (
    FieldMap,
    Regions,
    agreement,
    default_regions,
    field_map,
    force_agreement,
    force_errors,
    square,
)
from pinav.forces import ZeroForce
from pinav.scenarios.planar import paper_barrier
from pinav.trajectories import Trajectories


def line(units):
    """Positions from (0, 0) to (28, 7)."""
    states = np.linspace([0.0, 0.0], [28.0, 7.0], 200)
    times = np.linspace(0.0, 1.0, 200)
    return Trajectories.from_arrays(times, states, channels=("x", "y"), units=units)


def field(force, distance):
    return FieldMap(np.zeros(2), np.zeros(1), np.array([force]), np.array([distance]))


def test_regions_scale_with_the_extent_and_say_what_they_are():
    fixed = default_regions(line({"x": "1", "y": "1"}))
    assert (fixed.visited, fixed.near) == (0.35, 1.0)
    for units in ({"x": "um"}, {}):
        scaled = default_regions(line(units))
        assert (scaled.visited, scaled.near) == pytest.approx((0.7, 2.0))
    small = line({"x": "1", "y": "1"})
    small = eqx.tree_at(lambda t: t.states, small, 0.01 * small.states)
    scaled = default_regions(small)
    assert (scaled.visited, scaled.near) == pytest.approx((0.007, 0.02))
    assert square(line({"x": "um"})) == pytest.approx((-2.0, 30.0, -12.5, 19.5))
    text = Regions(2.0, 5.0).definition("um")
    assert "within 2 um of an observed position" in text
    assert "within 5 um, visited places included" in text
    with pytest.raises(InputError, match="Regions: expected 0 < visited < near, got"):
        Regions(2.0, 1.0)
    still = Trajectories.from_arrays([0.0, 1.0], np.ones((2, 2)), channels=("x", "y"))
    with pytest.raises(InputError, match="positions are the same, so there is no ext"):
        default_regions(still)
    masks = Regions().masks(np.array([0.0, 0.35, 0.9, 1.0, 1.1]))
    np.testing.assert_array_equal(masks["unvisited"], ~masks["near"])
    assert masks["visited"].tolist() == [True, True, False, False, False]


def test_error_and_cosine_are_those_of_the_plane():
    true = field([[3.0, 0.0], [0.0, 4.0]], [0.0, 2.0])
    scaled = FieldMap(true.x, true.y, 1.5 * true.force, true.distance)
    found = agreement(scaled, true, np.array([[True, True]]))
    assert found.error == pytest.approx(0.5)
    assert found.cosine == pytest.approx(1.0)
    turned = field([[0.0, 3.0], [0.0, 4.0]], [0.0, 2.0])
    by_region = force_agreement(turned, true)
    assert by_region["visited"].error == pytest.approx(np.sqrt(2.0))
    assert by_region["visited"].cosine == pytest.approx(0.0)
    assert by_region["unvisited"].error == pytest.approx(0.0)
    assert by_region["everywhere"].cosine == pytest.approx(16 / 25)
    assert force_errors(turned, true).keys() == {"visited", "near", "everywhere"}
    true = field([[3.0, 0.0], [0.0, 4.0]], [0.0, 0.1])
    empty = force_agreement(true, true)["unvisited"]
    assert (empty.points, np.isnan(empty.error), np.isnan(empty.cosine)) == (0, 1, 1)
    nothing = FieldMap(true.x, true.y, 0 * true.force, true.distance)
    found = force_agreement(nothing, true)["visited"]
    assert found.error == pytest.approx(1.0)
    assert np.isnan(found.cosine)


def test_changing_the_unit_of_length_changes_no_region():
    metres = line({"x": "m", "y": "m"})
    microns = eqx.tree_at(lambda t: t.states, metres, 1e6 * metres.states)
    first, second = (field_map(ZeroForce(), data) for data in (metres, microns))
    small, large = default_regions(metres), default_regions(microns)
    for name, mask in small.masks(first.distance).items():
        np.testing.assert_array_equal(mask, large.masks(second.distance)[name])


def test_the_truth_agrees_with_itself(paper_trajectories):
    true = field_map(paper_barrier(), paper_trajectories, points=9)
    for found in force_agreement(true, true).values():
        assert found.error == 0.0
        assert found.cosine == pytest.approx(1.0)
    assert jax.tree.leaves(Regions()) == []
