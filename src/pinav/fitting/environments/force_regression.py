"""Regression of kernels on forces that are known at places."""

import numpy as np
import scipy.linalg
from jaxtyping import Float

from pinav.forces import KernelForce, KernelPotential

KernelKind = type[KernelPotential] | type[KernelForce]
"""Kernels whose forces are known in closed form."""

RIDGE = 1e-11
"""Relative to the largest diagonal entry of the normal equations."""


def force_columns(
    kind: KernelKind,
    positions: Float[np.ndarray, "point dim"],
    centers: Float[np.ndarray, "kernel dim"],
    width: float,
) -> Float[np.ndarray, "point dim weight"]:
    """Force of each weight at each position."""
    offsets = (positions[:, None] - centers[None]) / width
    values = np.exp(-0.5 * np.sum(offsets**2, axis=2))
    if kind is KernelPotential:
        return np.moveaxis(offsets * values[..., None] / width, 2, 1)
    dim = positions.shape[1]
    columns = values[:, None, :, None] * np.eye(dim)[None, :, None, :]
    return columns.reshape(len(positions), dim, -1)


def regress(
    columns: Float[np.ndarray, "point dim weight"],
    forces: Float[np.ndarray, "point dim"],
) -> Float[np.ndarray, " weight"]:
    """Weights of least squares, with a ridge that rounding asks for."""
    return regress_with_ridges(columns, forces, (RIDGE,))[0]


def regress_with_ridges(
    columns: Float[np.ndarray, "point dim weight"],
    forces: Float[np.ndarray, "point dim"],
    ridges: tuple[float, ...],
) -> list[Float[np.ndarray, " weight"]]:
    """Weights of least squares with each of several ridges.

    Args:
        columns: force of each weight at each position.
        forces: to be explained.
        ridges: relative to the largest diagonal entry of the normal equations.
    """
    rows = columns.reshape(-1, columns.shape[-1])
    normal, right = rows.T @ rows, rows.T @ forces.reshape(-1)
    unit = normal.diagonal().max() * np.eye(len(normal))
    return [
        scipy.linalg.solve(normal + ridge * unit, right, assume_a="sym")
        for ridge in ridges
    ]
