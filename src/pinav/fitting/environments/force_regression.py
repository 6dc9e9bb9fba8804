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
    rows = columns.reshape(-1, columns.shape[-1])
    normal = rows.T @ rows
    ridge = RIDGE * normal.diagonal().max() * np.eye(len(normal))
    right = rows.T @ forces.reshape(-1)
    return scipy.linalg.solve(normal + ridge, right, assume_a="sym")


def regression_evidence(
    columns: Float[np.ndarray, "point dim weight"],
    forces: Float[np.ndarray, "point dim"],
) -> float:
    r"""Evidence of a regression for each number that it explains [nats].

    Weights and noise are normal, with variances $s^2$ and $\lambda s^2$. The forces
    $y$, in units of their root mean square, have the covariance
    $s^2 K = s^2 (X X^\top + \lambda I)$; the likeliest scale is
    $s^2 = y^\top K^{-1} y / n$, with which the logarithm of the evidence is
    $-\tfrac12 (n \ln 2\pi s^2 + \ln \det K + n)$. The likeliest of several $\lambda$
    counts. A regression that explains the forces up to a relative error e has some
    $-\ln e - 1.4$ less what its freedom costs.

    Args:
        forces: to be explained, not all zero.

    References:
        MacKay, Neural Computation 4, 415 (1992).
    """
    rows = columns.reshape(-1, columns.shape[-1])
    targets = forces.reshape(-1) / np.sqrt(np.mean(forces**2))
    values, vectors = scipy.linalg.eigh(rows.T @ rows)
    values = np.maximum(values, 0.0)
    along = (vectors.T @ (rows.T @ targets))[:, None] ** 2
    noise = NOISES * np.sum(rows**2, axis=0).max()
    count, spectrum = len(targets), values[:, None]
    # In float64 nothing is explained beyond its rounding, and the difference may be 0.
    left = count - np.sum(along / (noise + spectrum), axis=0)
    scale = np.maximum(left / count, ROUNDING) / noise
    determinant = np.sum(np.log1p(spectrum / noise), axis=0) / count + np.log(noise)
    return float(np.max(-0.5 * (np.log(2 * np.pi * scale) + determinant + 1.0)))


ROUNDING = 1e-14
"""Relative to the sum of squares of the forces."""

NOISES = 10.0 ** -np.arange(2.0, 13.0)
"""Variances of the noise that are tried, relative to the largest sum of squares of a
column."""
