"""The process on unvisited ground, against dense normal distributions and its draws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

from pinav.fitting.engine.unvisited import (
    MOST_PLACES,
    FieldDoubt,
    Ground,
    ProfileDoubt,
    doubts,
    thin,
)
from pinav.forces import (
    CentralTerm,
    ConstantForce,
    GaussianBarrier,
    KernelPotential,
    LinearTerm,
    PlaneWaves,
    StructuredForce,
    WallTerm,
    forces_at,
)

RNG = np.random.default_rng(3)
VISITED = RNG.uniform(0.0, 4.0, (300, 2))
WAVES = PlaneWaves(
    np.array([1.0, 0.7]), np.array([[1.5, 0.4], [-0.3, 1.1]]), np.zeros(2)
)
GROUND = Ground.of(WAVES, VISITED)
FAR = np.array([[40.0, -30.0], [-25.0, 60.0]])


def matern(first, second, length):
    """Matern's correlation of order 5/2, point by point."""
    a = np.sqrt(5.0) * np.linalg.norm(first[:, None] - second, axis=-1) / length
    return (1 + a + a * a / 3) * np.exp(-a)


def structured(*terms):
    centers = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), -1).reshape(-1, 2)
    return StructuredForce(terms, KernelPotential.with_zero_weights(centers, 1.0))


def central(low=0.25, high=5.0):
    places = jnp.arange(low, high, 0.25)
    weights = jnp.exp(-0.5 * (places - 2.0) ** 2)
    return CentralTerm(jnp.asarray(weights), jnp.asarray([2.0, 2.0]), places, 0.5)


def wall():
    places = jnp.arange(-2.0, 7.0, 0.5)
    weights = jnp.exp(-0.5 * (places - 1.0) ** 2)
    return WallTerm(jnp.asarray(weights), 0.3, jnp.zeros(2), places, 0.7)


def test_the_variance_is_that_of_a_process_that_is_known_where_somebody_was():
    points = RNG.uniform(-1.0, 5.0, (20, 2))
    places, length = GROUND.places, GROUND.length
    cross = matern(points, places, length)
    known = np.linalg.solve(matern(places, places, length), cross.T)
    expected = GROUND.size**2 * (1.0 - np.sum(cross * known.T, axis=1))
    np.testing.assert_allclose(
        GROUND.variance(points), expected, atol=1e-6 * GROUND.size**2
    )


def test_far_away_it_is_the_mean_square_of_the_force_and_at_the_places_nothing():
    forces = np.asarray(forces_at(WAVES, np.zeros(300), VISITED))
    assert GROUND.size == pytest.approx(np.sqrt(np.mean(forces**2)), rel=0.1)
    np.testing.assert_allclose(GROUND.variance(FAR), GROUND.size**2)
    assert np.all(GROUND.variance(GROUND.places) < 1e-6 * GROUND.size**2)


def test_it_falls_nowhere_with_the_distance_from_the_data():
    way = np.array([[2.0 + step, 2.0] for step in np.linspace(2.5, 30.0, 60)])
    assert np.all(np.diff(GROUND.variance(way)) > -1e-9)


def test_the_length_is_that_of_a_process_of_this_roughness():
    """Draws of the process have the length again with which they were drawn."""
    lengths = []
    empty = Ground(np.zeros((1, 2)), 1.0, 0.8, np.full((1, 1), 1e12))
    for seed in range(20):
        drawn = FieldDoubt(empty).draw(np.random.default_rng(seed))
        lengths.append(Ground.of(drawn, RNG.uniform(0.0, 40.0, (900, 2))).length)
    assert np.median(lengths) == pytest.approx(0.8, rel=0.15)


@pytest.mark.parametrize("doubt", [FieldDoubt(GROUND), "profile", "layer"])
def test_draws_spread_as_the_variance_says(doubt):
    if isinstance(doubt, str):
        term = central() if doubt == "profile" else wall()
        ring = VISITED[np.linalg.norm(VISITED - 2.0, axis=1) > 1.0]
        *_, doubt = doubts(structured(term), ring, lambda _, x: np.zeros_like(x))
        assert isinstance(doubt, ProfileDoubt)
    points = np.concatenate([RNG.uniform(-2.0, 6.0, (10, 2)), [[2.3, 2.1]]])
    generator = np.random.default_rng(5)
    drawn = [doubt.draw(generator) for _ in range(400)]
    forces = np.stack([forces_at(one, np.zeros(11), points) for one in drawn])
    expected = doubt.variance(points)
    scale = np.sqrt(expected.max())
    np.testing.assert_allclose(
        forces.std(axis=0), np.sqrt(expected), rtol=0.15, atol=0.02 * scale
    )
    assert np.all(
        np.abs(forces.mean(axis=0)) < 5 * np.sqrt(expected / 400) + 0.01 * scale
    )


def test_a_force_that_goes_on_into_an_unvisited_core_lies_in_the_band():
    """Hertz's contact grows to its centre, the kernels of a fit bend to zero there."""
    distances = np.linspace(2.2, 5.0, 80)
    angles = RNG.uniform(0.0, 2 * np.pi, 80)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    visited = 2.0 + distances[:, None] * directions
    places = np.arange(0.25, 5.0, 0.25)

    def contact(r):
        return 1.2 * np.maximum(3.0 - r, 0.0) ** 1.5

    seen = np.exp(-0.5 * ((distances[:, None] - places) / 0.4) ** 2)
    ridge = seen.T @ seen + 1e-3 * np.eye(len(places))
    weights = np.linalg.solve(ridge, seen.T @ contact(distances))
    middle = jnp.asarray([2.0, 2.0])
    term = CentralTerm(jnp.asarray(weights), middle, jnp.asarray(places), 0.4)
    *_, doubt = doubts(structured(term), visited, lambda _, x: np.zeros_like(x))
    radii = np.array([0.05, 0.5, 1.0, 1.5, 2.0])
    points = np.stack([2.0 + radii, np.full(5, 2.0)], axis=1)
    learned = np.asarray(forces_at(term, np.zeros(5), points))[:, 0]
    sd = np.sqrt(doubt.variance(points)[:, 0])
    assert np.all(np.abs(learned - contact(radii)) < norm.ppf(0.975) * sd)


def test_a_force_that_is_the_same_everywhere_leaves_no_doubt():
    linear = LinearTerm(jnp.asarray([0.3, 0.1, 0.0, 0.0, 0.0]), jnp.zeros(2), 1.0)
    parts = list(doubts(structured(linear), VISITED, lambda _, x: np.zeros_like(x)))
    assert len(parts) == 1  # of the kernels beside it, which have no weight
    assert np.all(parts[0].variance(FAR) == 0.0)


def test_what_is_unknown_among_the_data_is_unknown_elsewhere():
    """Kernels without a force have the variance of their posterior beyond the data."""
    kernels = structured(wall()).remainder
    (part,) = doubts(kernels, VISITED, lambda _, x: np.full_like(x, 0.25))
    np.testing.assert_allclose(part.variance(FAR), 0.25)


def test_a_uniform_force_may_change_over_the_extent_of_the_data():
    ground = Ground.of(ConstantForce(jnp.array([1.0, 0.0])), VISITED)
    assert ground.length == pytest.approx(np.linalg.norm(np.ptp(VISITED, axis=0)))


def test_nothing_visited_leaves_no_doubt():
    kernels = structured(wall()).remainder
    assert not list(doubts(kernels, np.zeros((0, 2)), lambda _, x: np.zeros_like(x)))


def test_places_are_thinned_to_a_number_that_a_matrix_bears():
    many = RNG.uniform(0.0, 100.0, (20_000, 2))
    few = thin(many, 1e-3)
    assert 0.3 * MOST_PLACES < len(few) <= MOST_PLACES
    assert {tuple(row) for row in few.tolist()} <= {tuple(row) for row in many.tolist()}


def test_a_drawn_force_can_be_differentiated_at_a_visited_place():
    drawn = FieldDoubt(GROUND).draw(np.random.default_rng(0))
    place = jnp.asarray(GROUND.places[0])
    slope = jax.jacfwd(lambda x: drawn(0.0, x, x))(place)
    assert np.all(np.isfinite(slope))


def test_a_hill_is_as_wide_beyond_as_it_is_high():
    hill = GaussianBarrier(5.0, [2.0, 2.0], 1.0)
    ground = Ground.of(hill, VISITED)
    assert ground.size > 1.0
    assert ground.length == pytest.approx(1.0, rel=0.5)
