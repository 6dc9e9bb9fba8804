"""Weights of kernels by least squares with a ridge, and their evidence."""

import numpy as np
import pytest

from pinav.fitting.environments.force_regression import (
    NOISES,
    RIDGE,
    force_columns,
    regress,
    regression_evidence,
)
from pinav.forces import KernelForce, KernelPotential


def draw_regression(kind):
    draw = np.random.default_rng(0)
    positions, centers = draw.normal(size=(40, 2)), draw.normal(size=(7, 2))
    columns = force_columns(kind, positions, centers, 1.0)
    return columns, draw.normal(size=(40, 2))


@pytest.mark.parametrize("kind", [KernelPotential, KernelForce])
def test_weights_are_those_of_least_squares(kind):
    columns, forces = draw_regression(kind)
    rows = columns.reshape(80, -1)
    plain = np.linalg.lstsq(rows, forces.ravel(), rcond=None)[0]
    assert regress(columns, forces) == pytest.approx(plain, rel=1e-4, abs=1e-6)
    asked = np.sqrt(RIDGE * np.sum(rows**2, axis=0).max()) * np.eye(rows.shape[1])
    padded = np.concatenate([rows, asked])
    right = np.concatenate([forces.ravel(), np.zeros(rows.shape[1])])
    expected = np.linalg.lstsq(padded, right, rcond=None)[0]
    assert regress(columns, forces) == pytest.approx(expected, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("kind", [KernelPotential, KernelForce])
def test_the_evidence_is_the_density_of_a_normal_distribution(kind):
    columns, forces = draw_regression(kind)
    rows, y = columns.reshape(80, -1), forces.ravel() / np.sqrt(np.mean(forces**2))
    top = np.sum(rows**2, axis=0).max()
    densities = []
    for noise in NOISES:
        shape = rows @ rows.T + noise * top * np.eye(80)
        scale = y @ np.linalg.solve(shape, y) / 80
        logarithm = np.linalg.slogdet(2.0 * np.pi * scale * shape)[1]
        squares = y @ np.linalg.solve(scale * shape, y)
        densities.append(-0.5 * (logarithm + squares) / 80)
    assert regression_evidence(columns, forces) == pytest.approx(max(densities))


def test_forces_of_the_columns_have_more_evidence_than_noise():
    columns, noise = draw_regression(KernelPotential)
    forces = columns @ np.random.default_rng(1).normal(size=7)
    assert regression_evidence(columns, forces) > 5.0
    assert regression_evidence(columns, noise) == pytest.approx(-1.4, abs=0.2)
    assert regression_evidence(columns, 100.0 * noise) == pytest.approx(
        regression_evidence(columns, noise)
    )
