"""Layers of kernels for forces along exact paths, finer where the force asks for it.

A grid of one width serves a hill that ends. One with a long tail acts wherever the
swimmer goes, and a grid that is fine enough for its flanks has thousands of kernels.
"""

import numpy as np
from jaxtyping import Int

from pinav.fitting.environments.force_prior import (
    AS_FINE_AS_FORCES,
    NOISE,
    force_columns,
    regress,
    white_part,
)
from pinav.fitting.environments.kernels import num_weights
from pinav.fitting.environments.rates import ForceSamples
from pinav.forces import KernelPotential, LayeredPotential, kernel_centers
from pinav.forces.priors import Matrix

ACROSS, WIDTH, MARGIN = 6, 1.5, 2.0
"""Intervals of the widest layer along the extent of the positions; width of a kernel
and reach of a layer beyond the positions that ask for it, in intervals of the layer."""

MOST_LAYERS = 7
"""Layers at most."""

EXPLAINED = 1e-6
"""Error of a force, relative to the largest one, that asks for no finer kernels."""

SHARE = 0.3
"""Forces whose error is above this share of the largest error ask for finer kernels.
Others may miss because these do."""

ROUNDS = 12
"""Iterations of the variances of layers."""


def lay_layers(samples: ForceSamples) -> LayeredPotential:
    """Layers of kernels, each half as wide as the one before.

    The widest layer surrounds all places; each further one the positions whose force
    the wider ones leave unexplained.
    """
    forces = samples.forces
    levels = np.zeros(len(forces), int)
    laid = _layers_around(samples, levels)
    largest = float(np.linalg.norm(forces, axis=1).max())
    while True:
        _, missed = regress(laid, samples)
        errors = np.linalg.norm(missed.reshape(forces.shape), axis=1)
        asking = errors > max(EXPLAINED * largest, SHARE * errors.max())
        levels = levels + asking
        if not asking.any() or levels.max() >= MOST_LAYERS:
            return laid
        finer = _layers_around(samples, levels)
        if num_weights(finer) > AS_FINE_AS_FORCES.max_weights:
            return laid
        laid = finer


def _layers_around(
    samples: ForceSamples, levels: Int[np.ndarray, " point"]
) -> LayeredPotential:
    """Kernels of every level around the positions of this level or of finer ones."""
    extent, layers = float(np.ptp(samples.places, axis=0).max()), []
    for level in range(levels.max() + 1):
        around = samples.positions[levels >= level] if level else samples.places
        spacing = extent / ACROSS / 2.0**level
        centers = kernel_centers(around, spacing=spacing, margin=MARGIN * spacing)
        layers.append(KernelPotential.with_zero_weights(centers, WIDTH * spacing))
    return LayeredPotential(tuple(layers))


def layers_root(environment: LayeredPotential, samples: ForceSamples) -> Matrix:
    r"""A root of the prior of layers: weights of one layer are alike in size.

    A layer is as fine as its kernels, so that its weights need no length scale. Their
    standard deviations $s_l$ follow from the evidence by
    $s_l^2 \leftarrow \lVert m_l \rVert^2 / \gamma_l$, with the mean m of the weights
    and the number $\gamma_l$ of those that the forces determine.

    References:
        MacKay, Neural Computation 4, 415 (1992), eq. (21).
    """
    columns = force_columns(environment, samples.positions)
    targets = samples.forces.reshape(-1)
    noise = NOISE * float(np.sqrt(np.mean(targets**2))) or 1.0
    rows = columns / noise
    normal, pull = rows.T @ rows, rows.T @ (targets / noise)
    counts = [num_weights(layer) for layer in environment.layers]
    layer = np.repeat(np.arange(len(counts)), counts)
    variances = np.full(len(layer), 1.0 / normal.diagonal().mean())
    mean = np.zeros_like(pull)
    for _ in range(ROUNDS):
        covariance = np.linalg.inv(normal + np.diag(1.0 / variances))
        mean = covariance @ pull
        determined = 1.0 - covariance.diagonal() / variances
        squares, known = (np.bincount(layer, w) for w in (mean**2, determined))
        # A layer that explains nothing keeps a variance next to none.
        variances = np.maximum(squares / known, 1e-20 * squares.sum())[layer]
    white = white_part(columns, columns @ mean - targets)
    return np.diag(np.sqrt(variances + white**2))
