r"""What a linearised fit says of the parameters, for each prior of its weights.

Weights with a Gaussian prior, whose covariance is that of a kernel field
(`fitting.priors`) or a multiple of one (`IsotropicPrior`), or no weights at all.
"""

import abc

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.fitting.evidence.evidence import (
    Hyperparameters,
    LinearisedObservations,
    at_shape,
    best_hyperparameters,
    weight_posterior,
)
from pinav.fitting.evidence.hyperparameter_uncertainty import shape_changes
from pinav.fitting.evidence.quadratic import Quadratic
from pinav.forces.priors import AbstractPrior, Matrix, Shape
from pinav.threads import map_on_cores

WeightPosterior = tuple[Float[np.ndarray, " weight"], Matrix]
"""Mean and covariance of the weights."""


class Inference(eqx.Module):
    """Hyperparameters and, given them, the weights."""

    hyperparameters: Hyperparameters
    mean: Float[np.ndarray, " weight"]
    covariance: Matrix


class AbstractWeights(eqx.Module):
    """What is known of the weights before the data."""

    @property
    @abc.abstractmethod
    def start(self) -> Shape:
        """Shape of the prior at which a fit begins."""

    def first_shape(self, quadratic: Quadratic, noise: float | None) -> Shape:
        """Shape at which the first search in a fit begins."""
        return self.start

    def search_anew(
        self, quadratic: Quadratic, chosen: Hyperparameters, noise: float | None
    ) -> Hyperparameters | None:
        """Hyperparameters that are likelier than the chosen ones, from other starts.

        None where there is one start alone, or the chosen ones are the likeliest.
        """
        return None

    def about(self, weights: Float[np.ndarray, " weight"]) -> "AbstractWeights":
        """The same where it depends on the point of linearisation."""
        return self

    @abc.abstractmethod
    def ridge(self, chosen: Hyperparameters) -> float:
        """Precision of each weight on its own; zero where `energy` tells more."""

    def energy(self, weights: Float[np.ndarray, " weight"]) -> float:
        """Twice the negative logarithm of the prior, less that of the ridge."""
        return 0.0

    @abc.abstractmethod
    def posterior(
        self, quadratic: Quadratic, chosen: Hyperparameters
    ) -> WeightPosterior:
        """Mean and covariance of the weights for these hyperparameters."""

    @abc.abstractmethod
    def infer(
        self, quadratic: Quadratic, shape: Shape, noise: float | None
    ) -> Inference:
        """Hyperparameters of highest evidence, sought from `shape`, and the weights."""

    @abc.abstractmethod
    def shape_covariance(
        self, quadratic: Quadratic, chosen: Hyperparameters, noise: float | None
    ) -> Matrix:
        """What the uncertainty of the prior's shape adds to the covariance."""


class GaussianWeights(AbstractWeights):
    """Weights with a Gaussian prior, chosen by the evidence.

    Attributes:
        tolerance: of the evidence; see `best_hyperparameters`.
    """

    prior: AbstractPrior
    tolerance: float = 1e-8

    @property
    def start(self) -> Shape:
        return self.prior.start

    def first_shape(self, quadratic: Quadratic, noise: float | None) -> Shape:
        starts = self.prior.starts
        if len(starts) == 1:
            return starts[0]
        data, covariance = LinearisedObservations.of(quadratic), self.prior.covariance
        tried = [at_shape(data, covariance, start, noise) for start in starts]
        return max(tried, key=lambda one: one.log_evidence).shape

    def search_anew(
        self, quadratic: Quadratic, chosen: Hyperparameters, noise: float | None
    ) -> Hyperparameters | None:
        prior = self.prior
        if len(prior.starts) == 1:
            return None
        data = LinearisedObservations.of(quadratic)
        tried = map_on_cores(
            lambda start: best_hyperparameters(data, prior, start, noise), prior.starts
        )
        best = max(tried, key=lambda one: one.log_evidence)
        return best if best.log_evidence > chosen.log_evidence + LIKELIER else None

    def ridge(self, chosen: Hyperparameters) -> float:
        return chosen.amplitude**-2

    def posterior(
        self, quadratic: Quadratic, chosen: Hyperparameters
    ) -> WeightPosterior:
        prior = self.prior.covariance(chosen.shape)
        return weight_posterior(LinearisedObservations.of(quadratic), prior, chosen)

    def infer(
        self, quadratic: Quadratic, shape: Shape, noise: float | None
    ) -> Inference:
        data = LinearisedObservations.of(quadratic)
        chosen = best_hyperparameters(data, self.prior, shape, noise, self.tolerance)
        weights = weight_posterior(data, self.prior.covariance(chosen.shape), chosen)
        return Inference(chosen, *weights)

    def shape_covariance(
        self, quadratic: Quadratic, chosen: Hyperparameters, noise: float | None
    ) -> Matrix:
        data = LinearisedObservations.of(quadratic)
        changes = shape_changes(data, self.prior, chosen, noise)
        return changes @ changes.T


LIKELIER = 1.0
"""Nats for which a fit goes on from other hyperparameters than those it came to."""


class NoWeights(AbstractWeights):
    r"""No weights: every parameter has a flat prior.

    The evidence is then that of the noise alone,
    $-2 \log Z = n \log 2\pi\sigma^2 + q/\sigma^2 + \log\det$, with $n$ the residuals
    less the parameters and $q$ the least sum of squares.
    """

    @property
    def start(self) -> Shape:
        return np.zeros(0)

    def ridge(self, chosen: Hyperparameters) -> float:
        return 0.0

    def posterior(
        self, quadratic: Quadratic, chosen: Hyperparameters
    ) -> WeightPosterior:
        return np.zeros(0), np.zeros((0, 0))

    def infer(
        self, quadratic: Quadratic, shape: Shape, noise: float | None
    ) -> Inference:
        # Exact data may leave no squares, and their logarithm is needed.
        squares = max(quadratic.squares, np.finfo(float).tiny)
        variance = squares / quadratic.num_free if noise is None else noise**2
        log_evidence = -0.5 * (
            quadratic.num_free * np.log(2 * np.pi * variance)
            + squares / variance
            + quadratic.log_determinant
        )
        chosen = Hyperparameters(
            shape=np.zeros(0),
            amplitude=0.0,
            noise=float(np.sqrt(variance)),
            log_evidence=float(log_evidence),
        )
        return Inference(chosen, np.zeros(0), np.zeros((0, 0)))

    def shape_covariance(
        self, quadratic: Quadratic, chosen: Hyperparameters, noise: float | None
    ) -> Matrix:
        return np.zeros((0, 0))
