"""Regression of kernels on forces that are known at places, on one grid or in layers.

A grid of one width serves a hill that ends. One with a long tail acts wherever the
swimmer goes, and a grid that is fine enough for its flanks has thousands of kernels:
layers are finer where the force asks for it.
"""

from collections.abc import Iterator

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

from pinav.fitting.environments.kernels import (
    MOST_MATCHED,
    KernelGrid,
    surround_with_kernels,
)
from pinav.forces import KernelForce, KernelPotential, kernel_centers

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


ACROSS = (6, 8, 11, 15, 20, 27, 36, 48)
"""Intervals of the grids of kernels that are tried, along the extent of the data."""


def match_grid(across: int) -> KernelGrid:
    """A grid of kernels without a prior, which are wide and close to the data."""
    return KernelGrid(across, width=1.5, margin=2.0)


def force_grids(
    kind: KernelKind,
    places: Float[np.ndarray, "place dim"],
    positions: Float[np.ndarray, "point dim"],
) -> Iterator[tuple[KernelGrid, Float[np.ndarray, "point dim weight"]]]:
    """Grids from coarse to fine until they are too many, with the force of each weight.

    Args:
        kind: of the kernels.
        places: which the kernels surround [L].
        positions: at which the force is known [L].
    """
    for across in ACROSS:
        grid = match_grid(across)
        centers, width = surround_with_kernels(places, grid)
        each = 1 if kind is KernelPotential else places.shape[1]
        if len(centers) * each > MOST_MATCHED:
            return
        yield grid, force_columns(kind, positions, centers, width)


FIRST_LAYER = match_grid(ACROSS[0])
"""The widest layer; others have the width and the margin in their own intervals."""

MOST_LAYERS = 7
"""Layers at most."""

LAYERS_EXPLAIN = 1e-6
"""Error of a force, relative to the largest one, that asks for no finer kernels."""

SHARE = 0.3
"""Forces whose error is above this share of the largest error ask for finer kernels.
Others may miss because these do."""


Layer = tuple[Float[np.ndarray, "_ dim"], float]
"""Centres and width of kernels of one width [L]."""


def lay_layers(
    positions: Float[np.ndarray, "point dim"], forces: Float[np.ndarray, "point dim"]
) -> tuple[Layer, ...]:
    """Layers of kernels, each half as wide as the one before.

    Each layer surrounds the positions whose force the wider ones leave unexplained.

    Args:
        positions: where the force is known, not all the same.
    """
    levels = np.zeros(len(positions), int)
    layers = _layers_around(positions, levels)
    largest = float(np.linalg.norm(forces, axis=1).max())
    while True:
        errors = _errors(layers, positions, forces)
        asking = errors > max(LAYERS_EXPLAIN * largest, SHARE * errors.max())
        if not asking.any():
            return layers
        levels = levels + asking
        finer = _layers_around(positions, levels)
        count = sum(len(centers) for centers, _ in finer)
        if len(finer) > MOST_LAYERS or count > MOST_MATCHED:
            return layers
        layers = finer


def _layers_around(
    positions: Float[np.ndarray, "point dim"], levels: Int[np.ndarray, " point"]
) -> tuple[Layer, ...]:
    """Kernels of every level around the positions of this level or of finer ones."""
    extent = float(np.ptp(positions, axis=0).max())
    spacings = [
        extent / FIRST_LAYER.across / 2.0**level for level in range(levels.max() + 1)
    ]
    return tuple(
        (
            kernel_centers(
                positions[levels >= level],
                spacing=spacing,
                margin=FIRST_LAYER.margin * spacing,
            ),
            FIRST_LAYER.width * spacing,
        )
        for level, spacing in enumerate(spacings)
    )


def _errors(
    layers: tuple[Layer, ...],
    positions: Float[np.ndarray, "point dim"],
    forces: Float[np.ndarray, "point dim"],
) -> Float[np.ndarray, " point"]:
    """Errors of the forces that the layers together make."""
    # Times the width, so that a ridge holds back no layer more than another.
    columns = np.concatenate(
        [
            width * force_columns(KernelPotential, positions, centers, width)
            for centers, width in layers
        ],
        axis=2,
    )
    return np.linalg.norm(columns @ regress(columns, forces) - forces, axis=1)
