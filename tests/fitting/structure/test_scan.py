"""Quick evidence of terms, pairs and sets, against matrices of all their columns."""

import numpy as np
import pytest
from tests.fitting.structure.observed_forces import observed_forces

from pinav.fitting.policy import POLICY
from pinav.fitting.structure.scan import Atoms, Held
from pinav.fitting.structure.starts import Region, central_term, linear_term, wall_term
from pinav.forces import GaussianBarrier, LinearForce, SumForce, soft_wall

POINTS = np.random.default_rng(1).uniform(0.0, 10.0, (1, 200, 2))
REGION = Region.of(POINTS[0])
HILL, WALL = GaussianBarrier(3.0, [4.0, 6.0], 1.5), soft_wall(6.0, 0.7, 9.0, 0.8)
SADDLE = LinearForce(np.array([[0.2, 0.05], [0.05, -0.2]]), [5.0, 5.0])


class Scanned:
    """Centres and walls beside a linear force in data of a force."""

    def __init__(self, truth, points=POINTS):
        self.data = observed_forces(truth, points, 0.01)
        region = Region.of(points[0])
        places = region.places()
        walls = np.pi * np.arange(POLICY.angles) / POLICY.angles
        self.held = Held.of((linear_term(region),), self.data)
        self.centres = Atoms.of([central_term(region, p) for p in places], self.data)
        self.walls = Atoms.of([wall_term(region, a) for a in walls], self.data)


@pytest.fixture(scope="module")
def scanned():
    return Scanned(HILL + WALL)


def log_evidence(held, parts, ratio):
    """That of columns whose weights and noise have variances in one ratio."""
    columns = np.concatenate([held.columns, *parts], axis=1)
    covariance = columns @ columns.T / ratio + np.eye(len(columns))
    squares = held.offset @ np.linalg.solve(covariance, held.offset)
    volume = np.linalg.slogdet(covariance).logabsdet
    return -0.5 * (held.num_free * np.log(squares) + volume)


def test_terms_beside_others_have_the_evidence_of_all_their_columns(scanned):
    held, walls = scanned.held, scanned.walls
    values = held.beside(walls)
    for index in (0, 4, 11):
        part = walls.columns[:, index]
        tried = [log_evidence(held, [part], ratio) for ratio in POLICY.ratios]
        assert values[index] == pytest.approx(max(tried) - walls.price, abs=1e-4)


def test_pairs_have_the_evidence_of_all_their_columns(scanned):
    held, walls, centres = scanned.held, scanned.walls, scanned.centres
    values = held.pairs(walls, centres)
    part = [walls.columns[:, 4], centres.columns[:, 20]]
    whole = log_evidence(held, part, POLICY.ratios[1])
    assert values[4, 20] == pytest.approx(whole - walls.price - centres.price, abs=1e-4)


def test_a_hill_and_a_wall_are_the_pair_that_explains_most(scanned):
    held, centres, walls = scanned.held, scanned.centres, scanned.walls
    table = held.pairs(centres, walls)
    alike = held.pairs(centres, centres).max(), held.pairs(walls, walls).max()
    assert table.max() > max(alike)
    centre, wall = np.unravel_index(np.argmax(table), table.shape)
    np.testing.assert_allclose(centres.terms[centre].center, [4.0, 6.0], atol=1.2)
    assert float(walls.terms[wall].angle) == pytest.approx(0.7, abs=0.1)


def test_no_pair_is_of_one_term_or_twice_the_same(scanned):
    table = scanned.held.pairs(scanned.walls, scanned.walls)
    assert not np.isfinite(table[np.tri(len(table), dtype=bool)]).any()
    assert np.isfinite(table[np.triu_indices(len(table), 1)]).all()


def test_centres_of_one_profile_are_found_together():
    centers = np.array([[3.0, 3.0], [7.0, 4.0], [5.0, 7.5]])
    scanned = Scanned(SumForce(tuple(GaussianBarrier(3.0, c, 1.0) for c in centers)))
    value, chosen = scanned.held.set_of_one_profile(scanned.centres)
    assert value > scanned.held.beside(scanned.centres).max() + 50
    found = np.stack([scanned.centres.terms[index].center for index in chosen])
    gaps = np.linalg.norm(found[:, None] - centers, axis=-1)
    assert gaps.min(axis=0).max() < 1.0


def test_where_swimmers_are_flung_out_the_right_place_is_the_likeliest():
    """Directions of most variance of the prior are where there are few data."""
    flung = np.concatenate([POINTS[0, :180], 8.0 * (POINTS[0, 180:] - 5.0)])[None]
    scanned = Scanned(HILL + SADDLE, flung)
    values = scanned.held.beside(scanned.centres)
    place = np.asarray(scanned.centres.terms[int(np.argmax(values))].center)
    gaps = [np.linalg.norm(t.center - HILL.center) for t in scanned.centres.terms]
    assert np.linalg.norm(place - np.asarray(HILL.center)) < min(gaps) + 0.5
