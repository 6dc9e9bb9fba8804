"""Moves of the geometry of terms at a fixed smoothness."""

import numpy as np
import pytest
from tests.fitting.structure.observed_forces import observed_forces

from pinav.fitting.evidence.evidence import root
from pinav.fitting.structure.moves import Placed, move
from pinav.fitting.structure.response import columns
from pinav.fitting.structure.starts import Region, central_term, ellipses, wall_term
from pinav.fitting.structure.trials import cost, scanned_shapes
from pinav.forces import GaussianBarrier, gaussian_ridge, soft_wall

POINTS = np.random.default_rng(1).uniform(0.0, 10.0, (1, 200, 2))
REGION = Region.of(POINTS[0])
HILL = GaussianBarrier(3.0, [4.0, 6.0], 1.5)
WALL = soft_wall(6.0, 0.7, 9.0, 0.8)
DATA = observed_forces(HILL + WALL, POINTS, 0.01)
NEAR = central_term(REGION, np.array([4.6, 5.3])), wall_term(REGION, 0.8)


def placed(terms):
    shapes = [scanned_shapes(term, DATA)[-1] for term in terms]
    pairs = zip(terms, shapes, strict=True)
    roots = [root(term.prior().covariance(shape)) for term, shape in pairs]
    return Placed.of(terms, roots, DATA)


def test_weights_are_those_of_a_regression_on_all_columns():
    one = placed(NEAR)
    x, offset = one.columns, DATA.residuals_of_none
    inner = x.T @ x + one.ratio * np.eye(x.shape[1])
    np.testing.assert_allclose(inner @ one.weights, -x.T @ offset, atol=1e-6)
    by_term = [columns(term, DATA) @ np.asarray(term.weights) for term in one.terms]
    np.testing.assert_allclose(offset + sum(by_term), one.left, atol=1e-8)


def test_the_quick_evidence_is_that_of_a_gaussian_with_the_noise_profiled():
    one = placed(NEAR)
    x, offset, count = one.columns, DATA.residuals_of_none, DATA.num_free
    # the data that no force explains add to the squares alone
    whole = np.eye(len(x)) + x @ x.T / one.ratio
    squares = offset @ np.linalg.solve(whole, offset) + DATA.squares
    value = -0.5 * count * np.log(squares) - 0.5 * np.linalg.slogdet(whole)[1]
    assert one.log_evidence == pytest.approx(value - cost(NEAR, DATA), rel=1e-8)


def test_all_terms_are_moved_together_to_where_they_are():
    found = move(NEAR, DATA)
    hill, wall = found.terms
    np.testing.assert_allclose(hill.center, [4.0, 6.0], atol=0.03)
    assert float(wall.angle) == pytest.approx(0.7, abs=0.01)
    assert found.log_evidence > placed(NEAR).log_evidence + 100


def test_the_axes_of_an_ellipse_are_moved():
    data = observed_forces(gaussian_ridge(3.0, [5.0, 5.0], 3.0, 1.2, 0.6), POINTS, 0.01)
    shear = np.array([[0.3, 0.5]])
    (moved,) = move(tuple(ellipses(REGION, np.array([[5.4, 4.8]]), shear)), data).terms
    assert np.hypot(*moved.shear) == pytest.approx(0.5 * np.log(3.0 / 1.2), rel=0.1)
    assert np.arctan2(*-moved.shear[::-1]) == pytest.approx(1.2, abs=0.1)
