r"""The evidence of a rotational part of a force.

A `KernelMixture` holds a stream function beside the potential, and a prior that may
send it to nothing. The two are compared in one and the same linear problem: of data
linearised about a fit or before any, where the comparison costs no dynamics; and about
the states of a fitted mixture, where it is that of the fits near the decision.
"""

from typing import Any, NamedTuple

import numpy as np

from pinav.errors import FitError
from pinav.fitting.engine.evidence_fit import EvidenceFit
from pinav.fitting.evidence.evidence import (
    LinearisedObservations,
    at_shape,
    best_hyperparameters,
)
from pinav.fitting.evidence.model_evidence import LinearFit, model_evidence
from pinav.fitting.evidence.quadratic import restrict
from pinav.fitting.evidence.weights import GaussianWeights
from pinav.fitting.policy import POLICY
from pinav.fitting.structure.response import ForceResponse, force_quadratic
from pinav.fitting.structure.trials import Terms
from pinav.forces import (
    AbstractLearnedForce,
    KernelMixture,
    KernelPlaces,
    KernelPotential,
    StructuredForce,
    split_structure,
)

RATIOS = (-3.0, -1.0, 1.0)
"""Logarithms of the amplitude of a rotational part, relative to the potential, that are
tried before any fit."""


class SurveyedRotation(NamedTuple):
    """Evidence of a rotational part in data that are linearised before any fit.

    Attributes:
        gain: log evidence of it beside a potential [nats].
        is_needed: a potential alone leaves more of the data unexplained than the noise.
        is_plain: a mixture explains the data, and a potential by far less.
    """

    gain: float
    is_needed: bool = False
    is_plain: bool = False


def survey_rotation(
    response: ForceResponse, noise: float, terms: Terms, kernels: KernelPlaces
) -> SurveyedRotation:
    """The evidence of a rotational part in the linearised data.

    It is compared beside conservative terms, if any. On too coarse kernels a rotational
    part explains what they miss. The search for its shape is short: the gain is a lower
    bound.
    """
    mixture = mixture_on(kernels)
    potential = mixture.gradient
    try:
        parts = *terms, potential, mixture.rotation
        quadratic = force_quadratic(parts, response)
        kept = np.ones(len(quadratic.gradient), bool)
        kept[-len(potential.weights) :] = False
        alone = LinearisedObservations.of(restrict(quadratic, kept))
        whole = LinearisedObservations.of(quadratic)
    except FitError:
        return SurveyedRotation(0.0)
    prior = _beside(terms, potential).prior()
    chosen = best_hyperparameters(alone, prior, prior.start)
    shared, ratio = np.split(chosen.shape, [-1 if terms else len(chosen.shape)])
    scale = shared[-len(potential.prior().start)]
    covariance = _beside(terms, mixture).prior().covariance
    stationary = potential.prior().start
    stationary[:2] = scale, potential.prior().bounds[1, 1]
    best = max(
        (
            at_shape(
                whole, covariance, np.concatenate([shared, stationary, [amount], ratio])
            )
            for amount in RATIOS
        ),
        key=lambda one: one.log_evidence,
    )
    gain = float(best.log_evidence - chosen.log_evidence)
    enough = POLICY.explained * noise
    is_needed = gain > POLICY.decisive and chosen.noise > enough
    is_plain = best.noise < min(enough, chosen.noise / POLICY.plain)
    return SurveyedRotation(gain, is_needed, is_needed and is_plain)


def fitted_gain(fit: EvidenceFit) -> float:
    """Log evidence of a mixture's fit over that of its conservative part alone [nats].

    Both are of the linear problem in which the fit ended.
    """
    force, linear = fit.model.environment, fit.linear
    conservative, kept, num_geometry = _without_rotation(force)
    prior = conservative.prior()
    reduced = LinearFit(
        quadratic=restrict(linear.quadratic, kept),
        weights=GaussianWeights(prior),
        noise=linear.noise,
        num_observed=linear.num_observed,
        flat_information=linear.flat_information,
    )
    chosen = best_hyperparameters(
        LinearisedObservations.of(reduced.quadratic), prior, prior.start, linear.noise
    )
    with_rotation = model_evidence(linear, fit.hyperparameters).log_evidence
    # the geometry of turning terms is a cost of theirs alone
    cost = 0.5 * num_geometry * float(np.log(linear.num_observed))
    without = model_evidence(reduced, chosen).log_evidence
    return with_rotation - without - cost


def mixture_on(kernels: KernelPlaces) -> KernelMixture:
    """An untrained mixture on given kernels."""
    centers = np.asarray(kernels.centers)
    return KernelMixture.with_zero_weights(centers, float(kernels.width))


def _beside(
    terms: Terms, free: KernelPotential | KernelMixture
) -> StructuredForce | KernelPotential | KernelMixture:
    return StructuredForce(terms, free) if terms else free


def _without_rotation(force: Any) -> tuple[AbstractLearnedForce, np.ndarray, int]:
    """The conservative part, its weights, and the numbers of the rest."""
    (terms, _), gradient = split_structure(force), force.helmholtz.gradient
    still = tuple(term for term in terms if not term.rotational)
    kept = [np.full(term.weights.size, not term.rotational) for term in terms]
    count = len(gradient.weights)
    kept += [np.full(count, fill) for fill in (True, False)]
    geometry = sum(
        leaf.size for term in terms if term.rotational for leaf in term.geometry
    )
    return _beside(still, gradient), np.concatenate(kept), int(geometry)
