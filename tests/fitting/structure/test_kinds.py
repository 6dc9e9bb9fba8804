"""Where terms of each kind may be, and what is simpler."""

import jax.numpy as jnp
import numpy as np
import pytest
from tests.fitting.structure.observed_forces import observed_forces

from pinav.fitting.structure.kinds import lattices, simple_kinds, with_one_less
from pinav.fitting.structure.search import simplify
from pinav.fitting.structure.starts import Region, central_term, obstacles_at, wall_term
from pinav.fitting.structure.trials import polish
from pinav.forces import CentralTerm, PlaneWaves, soft_wall

POINTS = np.random.default_rng(1).uniform(0.0, 10.0, (1, 300, 2))
REGION = Region.of(POINTS[0])


def response(truth):
    return observed_forces(truth, POINTS, 0.02)


def test_square_lattices_of_every_period_and_direction_are_tried():
    sizes = {
        round(float(np.linalg.norm(t.wave_vectors[0])), 6) for t in lattices(REGION)
    }
    assert min(sizes) < 2 * np.pi / 8.0
    assert max(sizes) > 2 * np.pi / 2.0
    for term in lattices(REGION):
        one, other = np.asarray(term.wave_vectors)
        assert abs(one @ other) < 1e-12


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
    terms = simplify(walls, data, REGION).terms
    assert [term.kind for term in terms] == kinds
    if kinds == ["lattice"]:
        sizes = np.linalg.norm(terms[0].wave_vectors, axis=1)
        np.testing.assert_allclose(sizes, SIZES, rtol=0.01)


PAIR = obstacles_at(
    central_term(REGION, np.array([3.0, 3.0])),
    jnp.array([[3.0, 3.0], [7.0, 4.0], [5.0, 7.5]]),
)


def test_obstacles_are_left_out_one_by_one():
    fewer = [np.asarray(term.centers[:, 0]).tolist() for term in with_one_less(PAIR)]
    assert fewer == [[7.0, 5.0], [3.0, 5.0], [3.0, 7.0]]
    alone = list(with_one_less(next(with_one_less(PAIR))))
    assert all(isinstance(term, CentralTerm) for term in alone)
    np.testing.assert_allclose([term.center[0] for term in alone], [5.0, 7.0])


def test_a_lattice_that_stands_for_a_wall_becomes_one():
    data = response(soft_wall(3.0, 0.4, 5.0, 0.8))
    wanted = 2 * np.pi / 8.0 * normal(0.4)
    waves = min(
        lattices(REGION),
        key=lambda one: np.linalg.norm(np.asarray(one.wave_vectors[0]) - wanted),
    )
    terms = simplify(polish((waves,), data), data, REGION).terms
    assert [term.kind for term in terms] == ["wall"]
    assert float(terms[0].angle) == pytest.approx(0.4, abs=0.01)


@pytest.mark.parametrize("rotational", [False, True])
def test_kinds_that_turn_are_scanned_where_that_is_asked(rotational):
    kinds = list(simple_kinds(REGION, REGION.places(), rotational=rotational))
    assert any(terms[0].rotational for terms in kinds) is rotational
    assert len(kinds) == (6 if rotational else 3)
