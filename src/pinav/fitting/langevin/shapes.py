"""The force over all shapes of its prior: few paths do not tell which one it has."""

import equinox as eqx

from pinav.fitting.engine.evidence_fit import EvidenceFit
from pinav.fitting.evidence.evidence import LinearisedObservations
from pinav.fitting.evidence.shape_mixture import mix_shapes
from pinav.fitting.evidence.weights import GaussianWeights

MOST_WEIGHTS = 800
"""Weights up to which shapes are mixed: each of 200 asks for a decomposition."""


def mix_over_shapes(fit: EvidenceFit) -> EvidenceFit:
    """The fit whose force is the mean over all shapes, with the bands of them all.

    Forces with more than `MOST_WEIGHTS` weights keep the best shape, and a normal
    distribution about it: so many are laid only where the data tell the shape.

    Args:
        fit: linear in its weights, with nothing else to learn.
    """
    weights = fit.linear.weights
    few = len(fit.posterior.mean) <= MOST_WEIGHTS
    if not (few and isinstance(weights, GaussianWeights)):
        return fit
    data = LinearisedObservations.of(fit.linear.quadratic)
    mixed = mix_shapes(data, weights.prior, fit.hyperparameters, fit.linear.noise)
    posterior = eqx.tree_at(
        lambda p: (p.mean, p.covariance), fit.posterior, (mixed.mean, mixed.covariance)
    )
    return eqx.tree_at(
        lambda f: (f.posterior, f.model), fit, (posterior, posterior.model)
    )
