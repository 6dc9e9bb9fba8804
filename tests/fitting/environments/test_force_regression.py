"""Weights of kernels by least squares with a ridge."""

import numpy as np
import pytest

from pinav.fitting.environments.force_regression import (
    force_columns,
    regress,
    regress_with_ridges,
)
from pinav.forces import KernelForce, KernelPotential


@pytest.mark.parametrize("kind", [KernelPotential, KernelForce])
def test_weights_with_a_ridge_are_those_of_rows_that_ask_for_zero(kind):
    draw = np.random.default_rng(0)
    positions, centers = draw.normal(size=(40, 2)), draw.normal(size=(7, 2))
    columns = force_columns(kind, positions, centers, 1.0)
    forces = draw.normal(size=(40, 2))
    rows = columns.reshape(80, -1)
    top = np.sum(rows**2, axis=0).max()
    ridges = (1e-6, 0.1)
    for ridge, weights in zip(
        ridges, regress_with_ridges(columns, forces, ridges), strict=True
    ):
        asked = np.sqrt(ridge * top) * np.eye(rows.shape[1])
        padded = np.concatenate([rows, asked])
        right = np.concatenate([forces.ravel(), np.zeros(rows.shape[1])])
        expected = np.linalg.lstsq(padded, right, rcond=None)[0]
        assert weights == pytest.approx(expected, rel=1e-6, abs=1e-8)
    plain = np.linalg.lstsq(rows, forces.ravel(), rcond=None)[0]
    assert regress(columns, forces) == pytest.approx(plain, rel=1e-4, abs=1e-6)
