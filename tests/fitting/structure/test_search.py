"""The search in data of forces that are observed themselves."""

import numpy as np
import pytest
from tests.fitting.structure.observed_forces import observed_forces

from pinav.fitting.structure.search import Search, preferred, refine, simplify
from pinav.fitting.structure.starts import (
    Region,
    central_term,
    ellipses,
    linear_term,
    wall_term,
)
from pinav.fitting.structure.trace import Trace
from pinav.fitting.structure.trials import Proposal, polish
from pinav.forces import (
    GaussianBarrier,
    LinearForce,
    PlaneWaves,
    SumForce,
    gaussian_ridge,
    ring_barrier,
    soft_wall,
)

POINTS = np.random.default_rng(1).uniform(0.0, 10.0, (1, 200, 2))
REGION = Region.of(POINTS[0])
SLOW = pytest.mark.slow

HILL = GaussianBarrier(3.0, [4.0, 6.0], 1.5)
WELL = GaussianBarrier(-2.0, [8.0, 2.5], 0.9)
WALL = soft_wall(6.0, 0.7, 9.0, 0.8)
SADDLE = LinearForce(np.array([[2.0, 0.5], [0.5, -2.0]]), [5.0, 5.0])
RIDGE = gaussian_ridge(3.0, [4.0, 5.0], 3.0, 1.1, 0.6)
SEGMENT = gaussian_ridge(3.0, [4.4, 6.4], 4.9, 0.7, 2.0)
SIDE = 2 * np.pi / 4.0 * np.array([np.cos(0.4), np.sin(0.4)])
WAVES = PlaneWaves(
    np.full(2, 1.0), np.stack([SIDE, [-SIDE[1], SIDE[0]]]), np.array([0.3, 1.0])
)
THREE = SumForce(
    tuple(GaussianBarrier(3.0, c, 1.0) for c in ([3.0, 3.0], [7.0, 4.0], [5.0, 7.5]))
)


def response(truth, points=POINTS, noise=0.01):
    return observed_forces(truth, points, noise)


def search(truth, **options):
    return Search(response(truth), REGION, 0.01, rotational=False, **options)


@pytest.mark.parametrize(
    ("truth", "kinds"),
    [
        pytest.param(SADDLE, ["linear"], id="saddle"),
        pytest.param(HILL + SADDLE, ["central", "linear"], id="hill-saddle"),
        pytest.param(HILL + WALL, ["central", "wall"], id="hill-wall", marks=SLOW),
        pytest.param(HILL + WELL, ["central", "central"], id="hill-well", marks=SLOW),
        pytest.param(RIDGE, ["elliptic"], id="ridge", marks=SLOW),
        pytest.param(SEGMENT, ["elliptic"], id="segment", marks=SLOW),
        pytest.param(RIDGE + WALL, ["elliptic", "wall"], id="ridge-wall", marks=SLOW),
        pytest.param(WAVES, ["lattice"], id="lattice", marks=SLOW),
        pytest.param(THREE, ["obstacles"], id="obstacles", marks=SLOW),
        pytest.param(HILL + WAVES, ["central", "lattice"], id="defect", marks=SLOW),
        pytest.param(
            HILL + WELL + WALL, ["central", "central", "wall"], id="three", marks=SLOW
        ),
    ],
)
def test_the_search_names_what_is_there_and_nothing_beside_it(truth, kinds):
    data = response(truth)
    best = simplify(search(truth).run()[0], data, REGION)
    assert sorted(term.kind for term in best.terms) == kinds
    assert best.noise == pytest.approx(0.01, rel=0.3)


def test_single_terms_alone_leave_most_of_a_lattice_unexplained():
    found = search(WAVES).run(singles_only=True)
    assert min(one.noise for one in found) > 0.05
    assert all(len(one.terms) <= 2 for one in found)


def test_a_search_whose_time_is_over_yields_the_best_so_far_and_says_so():
    trace = Trace(budget=0.0)
    found = search(WAVES, trace=trace).run()
    assert found
    values = [one.log_evidence for one in found]
    assert found[0].log_evidence >= max(values) - 10.0
    assert any("budget" in one.ended for one in trace.hypotheses)
    assert all("lattice" not in one.kinds for one in trace.hypotheses)


def test_a_trace_keeps_what_was_tried_with_its_misfit():
    trace = Trace()
    best = search(SADDLE, trace=trace).run()[0]
    (linear, *_) = (one for one in trace.hypotheses if one.kinds == ("linear",))
    assert linear.log_evidence == pytest.approx(best.log_evidence)
    assert linear.misfit == pytest.approx(best.noise / 0.01)
    seconds = [one.seconds for one in trace.hypotheses]
    assert seconds == sorted(seconds)


def proposal(log_evidence, *terms):
    return Proposal(terms, log_evidence, 0.01)


def test_the_evidence_decides_and_where_it_hardly_does_the_simpler_kind():
    linear, wall = linear_term(REGION), wall_term(REGION, 0.4)
    first, second = proposal(100.0, linear), proposal(105.0, wall)
    assert preferred([first, second])[0] is first
    better = proposal(150.0, wall)
    assert preferred([first, second, better]) == [better, first]  # each kind once


@SLOW
def test_a_centre_is_found_in_space():
    points = np.random.default_rng(1).uniform(0.0, 10.0, (1, 150, 3))
    center = [4.0, 6.0, 5.0]
    data = response(GaussianBarrier(3.0, center, 2.0), points)
    region = Region.of(points[0])
    found = Search(data, region, 0.01, rotational=True).run()[0]
    found = simplify(found, data, region)
    assert [term.kind for term in found.terms] == ["central"]
    np.testing.assert_allclose(found.terms[0].center, center, atol=0.03)


@SLOW
def test_a_needless_term_goes_and_a_needed_one_stays():
    data = response(HILL + SADDLE)
    hill = central_term(REGION, np.array([4.1, 5.9]))
    both = polish((linear_term(REGION), hill), data)
    assert len(simplify(both, data, REGION).terms) == 2
    spare = polish((wall_term(REGION, 1.2), hill), response(HILL))
    (term,) = simplify(spare, response(HILL), REGION).terms
    assert term.kind == "central"


@SLOW
def test_a_long_ellipse_is_the_wall_along_it():
    data = response(WALL)
    shear = np.array([[np.cos(1.4), np.sin(1.4)]])
    (term,) = ellipses(REGION, np.array([[5.0, 5.0]]), shear)
    (wall,) = simplify(polish((term,), data), data, REGION).terms
    assert wall.kind == "wall"
    np.testing.assert_allclose(wall.angle, 0.7, atol=0.01)


@SLOW
def test_profiles_become_finer_where_the_data_ask_for_it():
    narrow = ring_barrier(2.0, [5.0, 5.0], 3.0, 0.15)
    data = response(narrow)
    coarse = polish((central_term(REGION, np.array([5.02, 5.0])),), data)
    finer = refine(coarse, data)
    assert finer.terms[0].width < coarse.terms[0].width
    assert finer.log_evidence > coarse.log_evidence
    smooth = polish((central_term(REGION, np.array([4.1, 5.9])),), response(HILL))
    assert refine(smooth, response(HILL)) is smooth
