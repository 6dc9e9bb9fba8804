import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.fitting.structure.observed_forces import observed_forces

from pinav.fitting.engine.local_model import ravel_model
from pinav.fitting.structure.kinds import lattice_of
from pinav.fitting.structure.response import columns, force_quadratic
from pinav.fitting.structure.starts import (
    Region,
    central_term,
    linear_term,
    obstacles_at,
    wall_term,
)
from pinav.forces import (
    GaussianBarrier,
    HillsTerm,
    KernelPotential,
    SumForce,
    kernel_centers,
)
from pinav.forces.terms import WIDTHS

POINTS = np.random.default_rng(1).uniform(0.0, 10.0, (1, 40, 2))
REGION = Region.of(POINTS[0])
DATA = observed_forces(GaussianBarrier(3.0, [4.0, 6.0], 1.5), POINTS, 0.01)
CENTRAL = central_term(REGION, np.array([4.0, 6.0]))
WALLS = wall_term(REGION, 0.3), wall_term(REGION, 1.9)
HILLS = HillsTerm(
    jnp.zeros(2 * len(WIDTHS)),
    jnp.array([[2.0, 3.0], [7.0, 5.0]]),
    jnp.array([[0.1, 0.2, 0.0], [0.3, 0.0, -0.1]]),
)
TERMS = (
    CENTRAL,
    WALLS[0],
    linear_term(REGION),
    lattice_of(*WALLS),
    obstacles_at(CENTRAL, jnp.array([[2.0, 3.0], [7.0, 5.0]])),
    HILLS,
)


def weighted(term):
    weights = np.random.default_rng(4).normal(size=term.weights.shape)
    return eqx.tree_at(lambda one: one.weights, term, jnp.asarray(weights))


@pytest.mark.parametrize("term", TERMS, ids=lambda term: term.kind)
def test_a_term_is_its_columns_times_its_weights(term):
    """Also where the term has weights already, which its columns do not depend on."""
    term = weighted(term)
    left = columns(term, DATA) @ np.asarray(term.weights) + DATA.residuals_of_none
    np.testing.assert_allclose(left, np.asarray(DATA(term))[:-1], atol=1e-10)


def test_the_slopes_of_a_sum_are_those_of_its_residuals():
    force = SumForce(tuple(map(weighted, TERMS)))
    parametric, theta = ravel_model(
        force, lambda f: [(term.weights, term.geometry) for term in f.terms]
    )
    residuals, slopes = DATA.linearise(parametric, np.asarray(theta))
    np.testing.assert_allclose(residuals, np.asarray(DATA(force)), atol=1e-10)
    expected = jax.jacfwd(lambda at: DATA(parametric(at)))(theta)
    np.testing.assert_allclose(slopes, np.asarray(expected), atol=1e-9)


def test_parts_that_act_together_have_the_normal_equations_of_all_their_columns():
    centers = kernel_centers(POINTS[0], spacing=2.0, margin=2.0)
    parts = (CENTRAL, KernelPotential.with_zero_weights(centers, 2.0))
    rows = np.concatenate([columns(part, DATA) for part in parts], axis=1)
    made = force_quadratic(parts, DATA)
    np.testing.assert_allclose(made.hessian, rows.T @ rows)
    np.testing.assert_allclose(made.gradient, rows.T @ DATA.residuals_of_none)
