r"""Evidence that can be compared between models: what its free choices cost.

A fit reports $\log Z$ at its best hyperparameters and with improper flat priors of
starts and constants. Two corrections make it comparable.

1. A hyperparameter $h$, uniform over the range in which it is sought, is integrated
   out: $\log \int Z(h)\, dh / |h|$, by Laplace's method where $Z$ is narrow, by a sum
   over the range where it is broad. A choice on which nothing depends is free.
2. A start or constant with a flat prior gets that of unit information, as in the
   Bayesian information criterion: $\tfrac12 \log n$ each, with $n$ the observations
   that see it. It does not depend on how the constant is written.

References:
    MacKay, Neural Computation 11, 1035 (1999); Kass and Wasserman, J. Am. Stat. Assoc.
    90, 928 (1995), the prior of unit information.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.fitting.evidence.evidence import (
    Hyperparameters,
    LinearisedObservations,
    best_hyperparameters,
    evidence_of_scales,
)
from pinav.fitting.evidence.quadratic import Quadratic, restrict
from pinav.fitting.evidence.weights import AbstractWeights, GaussianWeights
from pinav.forces.priors import AbstractPrior, MixturePrior
from pinav.threads import map_on_cores

DECISIVE = 5.0
"""Nats from which a verdict is called decisive: odds of 150 to 1.

Reference: Kass and Raftery, J. Am. Stat. Assoc. 90, 773 (1995)."""

LOG_RANGE = 8.0
"""Range of the logarithms of amplitude and noise: a factor of 3000."""

STEP, POINTS, BROAD = 2e-3, 10, 0.1
"""Difference step; points over a range; share of the range that counts as broad."""


class LinearFit(eqx.Module):
    r"""The linear problem in which a fit ended.

    Attributes:
        quadratic: sum of squares as a function of the weights.
        noise: standard deviation of the residuals, where it was given.
        num_observed: number of residuals of the data; those that stand for priors of
            constants do not count, as these are charged like flat ones.
        flat_information: $\sum_j \log n_j$ over all unknowns with a flat prior; it
            takes the place of the determinant of what was integrated out.
        teacher: the fit that chose the prior, where it was another.
    """

    quadratic: Quadratic
    weights: AbstractWeights
    noise: float | None
    num_observed: int
    flat_information: float
    teacher: "LinearFit | None" = None


class ModelEvidence(eqx.Module):
    """The evidence of a model, and what it is made of [nats].

    Attributes:
        best: log evidence at the best hyperparameters, all flat priors proper.
        correction: what the choice of the hyperparameters costs (Occam factor), not
            negative.
    """

    best: float
    correction: float

    DERIVED: ClassVar = ("log_evidence",)

    @property
    def log_evidence(self) -> float:
        """Log evidence of the model."""
        return self.best - self.correction


def model_evidence(linear: LinearFit, chosen: Hyperparameters) -> ModelEvidence:
    """Evidence for comparing models of the same data.

    The prior of a distilled network is the process of its kernel model, and is charged
    that model's correction.
    """
    quadratic = linear.quadratic
    flat = linear.num_observed - quadratic.num_free
    best = chosen.log_evidence + 0.5 * (
        quadratic.log_determinant
        - flat * np.log(2 * np.pi * chosen.noise**2)
        - linear.flat_information
    )
    weights = linear.weights
    if isinstance(weights, GaussianWeights):
        return ModelEvidence(float(best), _correction(linear, weights.prior, chosen))
    if linear.teacher is not None:
        taught = model_evidence(linear.teacher, chosen)
        return ModelEvidence(float(best), taught.correction)
    cost = _narrow_cost(
        np.full((1, 1), 2.0 * quadratic.num_free), np.array([LOG_RANGE])
    )
    return ModelEvidence(float(best), 0.0 if linear.noise else cost)


def evidence_without_second(linear: LinearFit, chosen: Hyperparameters) -> float:
    """Log evidence of a model of two parts from where the second one is absent.

    About hyperparameters at which a part contributes next to nothing, Laplace's method
    charges all of its own: a small gain hides a whole range of ratios of amplitudes in
    which they are free.

    Args:
        linear: the problem of the fit, whose prior is a `MixturePrior`.
    """
    weights = linear.weights
    assert isinstance(weights, GaussianWeights)
    prior = weights.prior
    assert isinstance(prior, MixturePrior)
    count = len(prior.first.start)
    start = chosen.shape[:count]
    kept = np.arange(len(linear.quadratic.point)) < len(prior.first.covariance(start))
    alone = dataclasses.replace(
        linear,
        quadratic=restrict(linear.quadratic, kept),
        weights=GaussianWeights(prior.first),
    )
    best = best_hyperparameters(
        LinearisedObservations.of(alone.quadratic), prior.first, start, linear.noise
    )
    data = LinearisedObservations.of(linear.quadratic)
    lowest, highest = prior.bounds[-1]

    def value(ratio: Float[np.ndarray, " n"]) -> float:
        shape = np.concatenate([best.shape, chosen.shape[count:-1], ratio])
        covariance = prior.covariance(shape)
        return evidence_of_scales(data, covariance)(best.amplitude, best.noise)

    absent = np.array([lowest])
    ratio_cost = _broad_cost(value, absent, 0, lowest, highest - lowest)
    return model_evidence(alone, best).log_evidence - ratio_cost


def _correction(
    linear: LinearFit, prior: AbstractPrior, chosen: Hyperparameters
) -> float:
    """Minus the logarithm of the share of the hyperparameters that explain the data."""
    data = LinearisedObservations.of(linear.quadratic)
    known = linear.noise is not None
    start = np.append(chosen.shape, np.log([chosen.amplitude, chosen.noise]))
    ranges = np.append(np.ptp(prior.bounds, axis=1), [LOG_RANGE, LOG_RANGE])
    if known:
        start, ranges = start[:-1], ranges[:-1]

    @functools.cache  # many points differ in amplitude and noise alone
    def by_scales(shape: tuple[float, ...]) -> Callable[[float, float], float]:
        return evidence_of_scales(data, prior.covariance(np.array(shape)))

    def value(point: Float[np.ndarray, " n"]) -> float:
        amplitude = float(np.exp(point[len(chosen.shape)]))
        noise = float(np.exp(point[-1])) if linear.noise is None else linear.noise
        return by_scales(tuple(point[: len(chosen.shape)]))(amplitude, noise)

    bend = curvature(value, start, STEP)
    # Where the evidence hardly bends within a range, Laplace's method would leave the
    # range: there it is integrated on a grid.
    wide = np.diag(bend) < (BROAD * ranges) ** -2
    lower = np.append(prior.bounds[:, 0], start[len(chosen.shape) :] - LOG_RANGE / 2)
    cost = sum(
        _broad_cost(value, start, i, lower[i], ranges[i])
        for i in map(int, np.flatnonzero(wide))
    )
    narrow = ~wide
    return cost + _narrow_cost(bend[np.ix_(narrow, narrow)], ranges[narrow])


def curvature(
    value: Callable[[Float[np.ndarray, " n"]], float],
    point: Float[np.ndarray, " n"],
    step: float,
) -> Float[np.ndarray, "n n"]:
    """Hessian of minus a function, by central differences.

    Args:
        value: the function; it is called n (n + 1) + 1 times, by several threads.
    """
    steps = step * np.eye(len(point))
    middle = value(point)

    def second_differences(
        changes: Float[np.ndarray, "change n"],
    ) -> Float[np.ndarray, " change"]:
        both = [*(point + changes), *(point - changes)]
        above, below = np.reshape(map_on_cores(value, both), (2, -1))
        return above + below - 2 * middle

    along = second_differences(steps)
    hessian = np.diag(along)
    first, second = np.triu_indices(len(point), 1)
    # Along the sum of two steps: two new values a pair, not four.
    mixed = second_differences(steps[first] + steps[second])
    mixed = 0.5 * (mixed - along[first] - along[second])
    hessian[first, second] = hessian[second, first] = mixed
    return -hessian / step**2


def _narrow_cost(
    bend: Float[np.ndarray, "n n"], ranges: Float[np.ndarray, " n"]
) -> float:
    """By Laplace's method: a normal prior as high as the uniform one."""
    widths = ranges / np.sqrt(2 * np.pi)
    # In units of the ranges no direction can be wider than its range.
    values = np.linalg.eigvalsh(bend * np.outer(widths, widths))
    return float(0.5 * np.log(np.maximum(values, 1.0)).sum())


def _broad_cost(
    value: Callable[[Float[np.ndarray, " n"]], float],
    point: Float[np.ndarray, " n"],
    index: int,
    lower: float,
    extent: float,
) -> float:
    """By a sum over the range, the other hyperparameters held."""
    moved = np.tile(point, (POINTS, 1))
    moved[:, index] = lower + extent * (np.arange(POINTS) + 0.5) / POINTS
    values = map_on_cores(value, list(moved))
    # A place of the grid above the maximum that was found must not make the cost
    # negative.
    fraction = np.mean(np.exp(np.minimum(np.array(values) - value(point), 0.0)))
    return float(-np.log(max(fraction, 1 / POINTS)))
