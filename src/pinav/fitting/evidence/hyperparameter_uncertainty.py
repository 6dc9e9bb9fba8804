r"""What the uncertainty of a prior's shape adds to that of the weights."""

import numpy as np
from jaxtyping import Float

from pinav.fitting.evidence.evidence import (
    Hyperparameters,
    LinearisedObservations,
    Whitened,
    best_amplitude,
    posterior_mean,
    shape_slope,
)
from pinav.forces.priors import AbstractPrior, Matrix, Shape, WeightPrior
from pinav.threads import map_on_cores

STEP, SHAPE_SD = 1e-3, 2.0
"""Difference step in the shape, and standard deviation of its own prior.

Where the length scale is huge the reach R is known to some 4e-4; a step ten times as
long misses that curvature, and the bands become too narrow.
"""


def shape_covariance(
    data: LinearisedObservations,
    prior: AbstractPrior,
    chosen: Hyperparameters,
    noise: float | None = None,
) -> Matrix:
    r"""What the uncertainty of the prior's shape adds to the weights' covariance.

    $M A^{-1} M^\top$: see `shape_changes`.
    """
    changes = shape_changes(data, prior, chosen, noise)
    return changes @ changes.T


def shape_changes(
    data: LinearisedObservations,
    prior: AbstractPrior,
    chosen: Hyperparameters,
    noise: float | None = None,
) -> Float[np.ndarray, "weight shape"]:
    r"""Changes of the mean by independent standard deviations of the prior's shape.

    $M A^{-1/2}$ with the curvature $A$ of $-\log Z$ and the slope $M$ of the mean,
    by differences of the slope of $\log Z$ and of the mean. A normal distribution of
    standard deviation `SHAPE_SD` holds directions of the shape on which the evidence
    does not depend.

    References:
        MacKay, Neural Computation 11, 1035 (1999), section 5.
    """
    if not len(chosen.shape):
        return np.zeros((data.rows.shape[1], 0))
    slopes, spread = _slopes_and_spread(data, prior, chosen, noise)
    return slopes @ spread


def shape_spread(
    data: LinearisedObservations,
    prior: AbstractPrior,
    chosen: Hyperparameters,
    noise: float | None = None,
) -> Float[np.ndarray, "shape shape"]:
    r"""The symmetric root $A^{-1/2}$ of the covariance: see `shape_changes`.

    It does not depend on signs of eigenvectors, which rounding may turn.
    """
    root = _slopes_and_spread(data, prior, chosen, noise)[1]
    variances, vectors = np.linalg.eigh(root @ root.T)
    return (vectors * np.sqrt(variances)) @ vectors.T


def _slopes_and_spread(
    data: LinearisedObservations,
    prior: AbstractPrior,
    chosen: Hyperparameters,
    noise: float | None,
) -> tuple[Float[np.ndarray, "weight shape"], Float[np.ndarray, "shape shape"]]:
    def at(offset: Shape) -> Float[np.ndarray, " both"]:
        shape = chosen.shape + offset
        white = Whitened.of(data, prior.covariance(shape))
        best = best_amplitude(data, white, shape, noise)
        slope = shape_slope(data, white, best, prior)
        return np.append(slope, posterior_mean(white, best))

    unit = STEP * np.eye(len(chosen.shape))
    # Differences of slopes, not of values, which would lose half of the digits.
    above, below = np.array(map_on_cores(at, [*unit, *-unit])).reshape(2, len(unit), -1)
    both = (above - below).T / (2 * STEP)
    bend, slopes = -both[: len(unit)], both[len(unit) :]
    values, vectors = np.linalg.eigh((bend + bend.T) / 2)
    # A flat or rising direction is held by the prior of the shape alone.
    return slopes, vectors / np.sqrt(np.maximum(values, 0.0) + SHAPE_SD**-2)


def is_confined(prior: AbstractPrior, shape: Shape) -> bool:
    """Whether the search for the shape of a kernel prior ended at a lower bound.

    The evidence would choose a narrower prior than the kernels allow. It still rises
    there, so that a normal distribution about this shape knows nothing of others, and
    the bands made from it are too narrow. Other priors have bounds at which a part of
    them vanishes, which means nothing of the kind.
    """
    if not isinstance(prior, WeightPrior) or len(shape) != len(prior.bounds):
        return False
    return bool(np.any(shape[:2] <= prior.bounds[:2, 0] + STEP))
