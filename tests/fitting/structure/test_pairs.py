"""Pairs of terms, against the sums that they are to find."""

import numpy as np
import pytest
from tests.fitting.structure.observed_forces import observed_forces

from pinav.fitting.structure.patterns import scan_pairs
from pinav.fitting.structure.proposals import propose
from pinav.fitting.structure.starts import Region, scanned_terms
from pinav.fitting.structure.trials import smooth_shape
from pinav.forces import GaussianBarrier, SumForce, soft_wall

POINTS = np.random.default_rng(1).uniform(0.0, 10.0, (1, 200, 2))
REGION = Region.of(POINTS[0])
HILL, WALL = GaussianBarrier(3.0, [4.0, 6.0], 1.5), soft_wall(6.0, 0.7, 9.0, 0.8)


@pytest.fixture(scope="module")
def pairs():
    """The best pairs of terms of a hill and a wall."""
    data = observed_forces(HILL + WALL, POINTS, 0.01)
    linear, *kinds = scanned_terms(REGION, np.zeros((0, 2)), rotational=False)
    shapes = [smooth_shape(one[0], data) for one in kinds]
    return scan_pairs(kinds, shapes, linear[0], data)


def test_a_hill_and_a_wall_are_the_pair_that_explains_most(pairs):
    best = pairs[0]
    assert [term.kind for term in best.terms] == ["central", "wall"]
    np.testing.assert_allclose(best.terms[0].center, [4.0, 6.0], atol=1.0)
    assert float(best.terms[1].angle) == pytest.approx(0.7, abs=0.1)


def test_the_best_pair_of_each_two_kinds_comes_in_order_and_is_of_two_terms(pairs):
    assert len(pairs) == 3  # two kinds, and each beside itself
    values = [one.log_evidence for one in pairs]
    assert values == sorted(values, reverse=True)
    for pair in pairs:
        first, second = (term.geometry for term in pair.terms)
        assert not np.array_equal(np.ravel(first), np.ravel(second))


@pytest.mark.slow
def test_the_search_names_two_hills_that_differ_beside_a_linear_start():
    other = GaussianBarrier(-2.0, [8.0, 2.5], 0.9)
    data = observed_forces(SumForce((HILL, other)), POINTS, 0.01)
    made = propose(data, REGION, 0.01, rotational=False)
    assert [term.kind for term in made.terms] == ["central", "central"]


@pytest.mark.slow
def test_the_search_names_a_hill_and_a_wall():
    data = observed_forces(HILL + WALL, POINTS, 0.01)
    made = propose(data, REGION, 0.01, rotational=False)
    assert sorted(term.kind for term in made.terms) == ["central", "wall"]
