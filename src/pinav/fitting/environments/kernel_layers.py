"""Layers of kernels that are finer where the force asks for it.

A grid of one width serves a hill that ends. One with a long tail acts wherever the
swimmer goes, and a grid that is fine enough for its flanks has thousands of kernels.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pinav.fitting.environments.force_regression import force_columns, regress
from pinav.forces import KernelPotential, kernel_centers

ACROSS, WIDTH, MARGIN = 6, 1.5, 2.0
"""Intervals of the widest layer along the extent of the positions; width of a kernel
and reach of a layer beyond the positions that ask for it, in intervals of the layer."""

MOST_KERNELS, MOST_LAYERS = 900, 7
"""Of all layers together, and their number."""

EXPLAINED = 1e-6
"""Error of a force, relative to the largest one, that asks for no finer kernels."""

SHARE = 0.3
"""Forces whose error is above this share of the largest error ask for finer kernels.
Others may miss because these do."""


class Layer(NamedTuple):
    """Kernels of one width."""

    centers: Float[np.ndarray, "kernel dim"]
    width: float


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
        asking = errors > max(EXPLAINED * largest, SHARE * errors.max())
        if not asking.any():
            return layers
        levels = levels + asking
        finer = _layers_around(positions, levels)
        count = sum(len(layer.centers) for layer in finer)
        if len(finer) > MOST_LAYERS or count > MOST_KERNELS:
            return layers
        layers = finer


def _layers_around(
    positions: Float[np.ndarray, "point dim"], levels: Int[np.ndarray, " point"]
) -> tuple[Layer, ...]:
    """Kernels of every level around the positions of this level or of finer ones."""
    extent = float(np.ptp(positions, axis=0).max())
    spacings = [extent / ACROSS / 2.0**level for level in range(levels.max() + 1)]
    return tuple(
        Layer(
            kernel_centers(
                positions[levels >= level], spacing=spacing, margin=MARGIN * spacing
            ),
            WIDTH * spacing,
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
