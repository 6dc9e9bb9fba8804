r"""Uncertainty of a prior's shape: its share in the weights, and a mixture of shapes.

With few data the evidence does not tell one length scale or envelope from another. A
normal distribution about the best shape then makes bands too sure: the best shape may
lie at an edge of what is possible, or be one maximum of several.
"""

import numpy as np
from jaxtyping import Float

from pinav.fitting.evidence.evidence import (
    Hyperparameters,
    LinearisedObservations,
    Whitened,
    at_shape,
    best_amplitude,
    posterior_mean,
    shape_slope,
    weight_posterior,
)
from pinav.forces.priors import AbstractPrior, Matrix, Shape, WeightPrior
from pinav.threads import map_on_cores

STEP, SHAPE_SD = 1e-3, 2.0
"""Difference step in the shape, and standard deviation of its own prior.

Where the length scale is huge the reach R is known to some 4e-4; a step ten times as
long misses that curvature, and the bands become too narrow.
"""


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


def _slopes_and_spread(
    data: LinearisedObservations,
    prior: AbstractPrior,
    chosen: Hyperparameters,
    noise: float | None,
) -> tuple[Float[np.ndarray, "weight shape"], Float[np.ndarray, "shape shape"]]:
    r"""$M$ and the symmetric root $A^{-1/2}$: see `shape_changes`.

    The root does not depend on signs of eigenvectors, which rounding may turn.
    """

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
    spread = vectors / np.sqrt(np.maximum(values, 0.0) + SHAPE_SD**-2)
    return slopes, spread @ vectors.T


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


DRAWS = (64, 64, 64)
"""Shapes of each stage, which draws where the ones before found the evidence."""

WIDER = 1.5
"""Factor in the standard deviations of what the first stage draws from: the evidence
has longer tails than a normal distribution."""

LATER_WIDER = 1.2
"""Factor in the standard deviations of what later stages draw from."""

FEW = 10.0
"""Effective number of draws below which the next stage trusts their weights less."""

LEAST_SHARE = 1e-4
"""Share of a draw that counts."""


def mix_shapes(
    data: LinearisedObservations,
    prior: AbstractPrior,
    chosen: Hyperparameters,
    noise: float | None = None,
) -> tuple[Float[np.ndarray, " weight"], Matrix]:
    r"""Mean and covariance of the weights over all shapes within the bounds.

    Each shape is as likely as its evidence: $p(w) = \sum_k \pi_k\, p(w \mid s_k)$ with
    $\pi_k \propto Z(s_k) / q(s_k)$: importance sampling in stages, in which q is the
    mixture of the normal distributions of all stages so far. The first is that of
    Laplace's method about the best shape. Amplitude and noise are the best
    ones of each shape.

    Args:
        prior: of the weights; without a shape there is nothing to mix.
        chosen: hyperparameters of highest evidence, about which shapes are drawn first.
        noise: standard deviation of the residuals; that of each shape unless given.

    References:
        Cappe, Guillin, Marin and Robert, J. Comput. Graph. Stat. 13, 907 (2004); Owen
        and Zhou, J. Am. Stat. Assoc. 95, 135 (2000).
    """
    if not len(chosen.shape):
        return weight_posterior(data, prior.covariance(chosen.shape), chosen)
    rng = np.random.default_rng(0)
    low, high = prior.bounds.T
    first = WIDER * _slopes_and_spread(data, prior, chosen, noise)[1]
    stages, fits, shares = [(chosen.shape, first)], [chosen], np.ones(1)
    for count in DRAWS:
        middle, spread = stages[-1]
        drawn = middle + rng.standard_normal((count, len(middle))) @ spread.T
        for shape in drawn[np.all((drawn >= low) & (drawn <= high), axis=1)]:
            fits.append(at_shape(data, prior.covariance, shape, noise))
        shapes = np.array([fit.shape for fit in fits])
        shares = _shares(np.array([fit.log_evidence for fit in fits]), shapes, stages)
        stages.append(_next_stage(shapes, shares))
    kept = np.flatnonzero(shares > LEAST_SHARE)
    shares = shares[kept] / shares[kept].sum()
    means, within = [], np.zeros(2 * (data.rows.shape[1],))
    for share, index in zip(shares, kept, strict=True):
        covariance = prior.covariance(fits[index].shape)
        mean, given = weight_posterior(data, covariance, fits[index])
        means.append(mean)
        within += share * given
    mean = shares @ np.array(means)
    offsets = np.array(means) - mean
    return mean, within + (offsets.T * shares) @ offsets


Stage = tuple[Shape, Float[np.ndarray, "shape shape"]]
"""Mean of a normal distribution, and a root of its covariance."""


def _shares(
    log_evidence: Float[np.ndarray, " draw"],
    shapes: Float[np.ndarray, "draw shape"],
    stages: list[Stage],
) -> Float[np.ndarray, " draw"]:
    """How likely each draw is, from what it was drawn from and its evidence."""
    densities = []
    for (middle, spread), count in zip(stages, DRAWS, strict=False):
        scaled = np.linalg.solve(spread, (shapes - middle).T)
        size = np.linalg.slogdet(spread)[1]
        # Each draw is weighed by the density of all stages together, which bounds the
        # weight of one that its own stage would seldom have made.
        densities.append(np.log(count) - size - 0.5 * (scaled**2).sum(axis=0))
    # In logarithms: evidences differ by hundreds of nats.
    logs = log_evidence - np.logaddexp.reduce(densities, axis=0)
    shares = np.exp(logs - logs.max())
    return shares / shares.sum()


def _next_stage(
    shapes: Float[np.ndarray, "draw shape"], shares: Float[np.ndarray, " draw"]
) -> Stage:
    """A normal distribution like the draws, flattened where few of them count."""
    least = 1e-3
    if 1 / (shares**2).sum() < FEW:
        # A few draws outweigh all others: tempered, they do not collapse the next
        # stage.
        shares, least = np.sqrt(shares) / np.sqrt(shares).sum(), 1e-2
    middle = shares @ shapes
    offsets = shapes - middle
    covariance = (offsets.T * shares) @ offsets + least * np.eye(len(middle))
    return middle, LATER_WIDER * np.linalg.cholesky(covariance)
