import numpy as np
import pytest
from tests.fitting.structure.observed_forces import observed_forces

from pinav.fitting.structure.patterns import (
    PotentialMap,
    lattices,
    obstacles,
    twins,
    with_one_less,
)
from pinav.fitting.structure.proposals import propose, prune
from pinav.fitting.structure.starts import Region, central_term, wall_term
from pinav.fitting.structure.trials import polish
from pinav.forces import (
    CentralTerm,
    GaussianBarrier,
    LatticeTerm,
    LinearForce,
    PlaneWaves,
    SumForce,
    soft_wall,
)

POINTS = np.random.default_rng(1).uniform(0.0, 10.0, (1, 300, 2))
REGION = Region.of(POINTS[0])


def response(truth):
    return observed_forces(truth, POINTS, 0.02)


def test_obstacles_are_sought_at_the_peaks_of_the_free_potential():
    centers = np.array([[3.0, 3.0], [7.0, 4.0], [5.0, 7.5]])
    hills = SumForce(tuple(GaussianBarrier(3.0, place, 1.0) for place in centers))
    seen = PotentialMap.of(response(hills))
    (term,) = (t for t in obstacles(seen, REGION) if len(t.centers) == 3)
    gaps = np.linalg.norm(np.asarray(term.centers)[:, None] - centers, axis=-1)
    assert gaps.min(axis=0).max() < 0.4


def test_a_hill_is_a_summit_whatever_linear_force_stands_beside_it():
    hill = GaussianBarrier(3.0, [4.0, 6.0], 1.0)
    saddle = LinearForce(np.array([[1.0, 0.5], [0.5, -1.0]]), [5.0, 5.0])
    summits = PotentialMap.of(response(hill + saddle)).summits()
    np.testing.assert_allclose(summits[0], [4.0, 6.0], atol=0.5)


def test_square_lattices_of_every_period_and_direction_are_tried():
    sizes = {
        round(float(np.linalg.norm(t.wave_vectors[0])), 6) for t in lattices(REGION)
    }
    assert min(sizes) < 2 * np.pi / 8.0
    assert max(sizes) > 2 * np.pi / 2.0
    for term in lattices(REGION):
        one, other = np.asarray(term.wave_vectors)
        assert abs(one @ other) < 1e-12


@pytest.mark.slow
def test_the_search_names_a_lattice():
    along = 2 * np.pi / 4.0 * np.array([np.cos(0.4), np.sin(0.4)])
    vectors = np.stack([along, [-along[1], along[0]]])
    waves = PlaneWaves(np.full(2, 1.0), vectors, np.array([0.3, 1.0]))
    (term,) = propose(response(waves), REGION, 0.02, rotational=False).terms
    assert isinstance(term, LatticeTerm)
    found = np.asarray(term.wave_vectors)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 2 * np.pi / 4, rtol=0.01)


def normal(angle):
    return np.array([np.cos(angle), np.sin(angle)])


SIZES = 2 * np.pi / np.array([4.0, 5.0])
WAVES = np.stack([SIZES[0] * normal(0.4), SIZES[1] * normal(1.8)])
STEPS = soft_wall(3.0, 0.4, 5.0, 0.8) + soft_wall(3.0, 1.8, 4.0, 0.8)


@pytest.mark.parametrize(
    ("truth", "kinds"),
    [
        (PlaneWaves(np.full(2, 1.0), WAVES, np.array([0.3, 1.0])), ["lattice"]),
        (STEPS, ["wall", "wall"]),
    ],
)
def test_two_walls_become_a_lattice_where_they_are_waves(truth, kinds):
    data = response(truth)
    walls = polish((wall_term(REGION, 0.42), wall_term(REGION, 1.78)), data)
    terms = prune(walls, data).terms
    assert [term.kind for term in terms] == kinds
    if kinds == ["lattice"]:
        sizes = np.linalg.norm(terms[0].wave_vectors, axis=1)
        np.testing.assert_allclose(sizes, SIZES, rtol=0.01)


def test_obstacles_are_joined_one_by_one_and_left_out_one_by_one():
    first = central_term(REGION, np.array([3.0, 3.0]))
    (pair,) = twins(first, np.array([[7.0, 4.0]]))
    np.testing.assert_allclose(pair.centers, [[3.0, 3.0], [7.0, 4.0]])
    (three,) = twins(pair, np.array([[5.0, 7.5]]))
    fewer = [np.asarray(term.centers[:, 0]).tolist() for term in with_one_less(three)]
    assert fewer == [[7.0, 5.0], [3.0, 5.0], [3.0, 7.0]]
    alone = list(with_one_less(pair))
    assert all(isinstance(term, CentralTerm) for term in alone)
    np.testing.assert_allclose([term.center[0] for term in alone], [7.0, 3.0])
