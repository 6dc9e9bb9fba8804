"""Terms tried on the linearised data: their profiles, their evidence, and a polish.

A geometry is scored at a fixed smoothness of the profiles in milliseconds; the engine's
own steps polish the geometries that are worth it.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar, on_device
from pinav.errors import FitError
from pinav.fitting.engine.evidence_fit import iterate
from pinav.fitting.engine.local_model import ConstantPriors, wide_priors
from pinav.fitting.engine.problem import FullStep, Step
from pinav.fitting.evidence.evidence import (
    LinearisedObservations,
    Whitened,
    at_shape,
    best_hyperparameters,
    posterior_mean,
)
from pinav.fitting.evidence.weights import GaussianWeights
from pinav.fitting.least_squares import Regression
from pinav.fitting.policy import POLICY
from pinav.fitting.structure.response import ForceResponse, force_quadratic
from pinav.forces import AbstractProfileTerm, AbstractTerm, SumForce
from pinav.forces.fitted_laws import FittedLaw
from pinav.forces.priors import AbstractPrior
from pinav.forces.structures import prior_of

ROUGHLY = 1e-6
"""Change of the log evidence, relative to it, at which the hyperparameters of a
proposal are known well enough: about a hundredth of a nat."""

Terms = tuple[AbstractTerm, ...]


class Proposal(eqx.Module):
    """Terms with their geometry, and their evidence in the linearised data.

    Attributes:
        length_scales: of the profile of each term, in widths of its kernels; infinite
            where it has none.
        is_rough: True if they may leave more unexplained than the noise, which they
            must not do about the path of a fit.
    """

    terms: Terms
    log_evidence: float
    noise: float
    length_scales: tuple[float, ...] = ()
    is_rough: bool = False

    @property
    def finer(self) -> Terms | None:
        """The terms with finer profiles where they are too coarse; None if none is."""
        coarse = [scale < POLICY.shortest for scale in self.length_scales]
        if not any(coarse):
            return None
        return tuple(
            _with_finer_profile(term)
            if is_coarse and isinstance(term, AbstractProfileTerm)
            else term
            for term, is_coarse in zip(self.terms, coarse, strict=True)
        )


def _with_finer_profile(term: AbstractProfileTerm) -> AbstractTerm:
    width, count = term.width / 2, 2 * len(term.places)
    places = (np.arange(count) + 0.5) * width
    if not term.is_odd:
        places = term.places[0] + np.arange(count - 1) * width
    return with_places(term, np.asarray(places), width)


def with_places(
    term: AbstractProfileTerm,
    places: Float[np.ndarray, " kernel"],
    width: Scalar,
    law: FittedLaw | None = None,
) -> AbstractProfileTerm:
    """The term with other kernels, without weight; its law stays unless given."""
    law = term.law if law is None else law
    weights = on_device(np.zeros(len(places) + (law is not None)))
    return dataclasses.replace(
        term, weights=weights, places=on_device(places), width=width, law=law
    )


def _linearise(terms: Terms, response: ForceResponse) -> LinearisedObservations:
    """Linear problem of the weights of terms of a given geometry."""
    return LinearisedObservations.of(force_quadratic(terms, response))


def _geometry(force: Any) -> list[PyTree]:
    return [leaf for term in force.terms for leaf in term.geometry]


def _weights(force: Any) -> PyTree:
    return [term.weights for term in force.terms]


def with_profiles(terms: Terms, response: ForceResponse) -> Terms:
    """The terms with the weights of highest evidence; FitError if undetermined."""
    prior, data = prior_of(terms), _linearise(terms, response)
    shapes = _smooth_shapes(terms, prior, response)
    tried = [at_shape(data, prior.covariance, shape) for shape in shapes]
    start = max(tried, key=lambda one: one.log_evidence).shape
    chosen = best_hyperparameters(data, prior, start, tolerance=ROUGHLY)
    white = Whitened.of(data, prior.covariance(chosen.shape))
    mean, made = posterior_mean(white, chosen), []
    for term in terms:
        count = len(term.weights)
        weights, mean = on_device(mean[:count]), mean[count:]
        made.append(eqx.tree_at(lambda one: one.weights, term, weights))
    return tuple(made)


def _smooth_shapes(
    terms: Terms, prior: AbstractPrior, response: ForceResponse
) -> list[Float[np.ndarray, " shape"]]:
    """Starts of a search, of a few smoothnesses that all profiles share."""
    shapes = []
    for each in zip(*(scanned_shapes(term, response) for term in terms), strict=True):
        shape = prior.start.copy()
        for own, place in zip(each, _shape_places(terms), strict=True):
            shape[place : place + len(own)] = own
        shapes.append(shape)
    return shapes


def _has_kernels(term: AbstractTerm) -> bool:
    return isinstance(term, AbstractProfileTerm) and term.has_kernels


def scanned_shapes(
    term: AbstractTerm, response: ForceResponse
) -> list[Float[np.ndarray, " shape"]]:
    """Shapes of the prior at which a term is tried, the smoothest first."""
    shapes = []
    for smoothness in POLICY.smoothness:
        shape = term.prior().start.copy()
        if _has_kernels(term):
            kernels = POLICY.kernels[response.points.shape[-1] == 3]
            shape[0] = np.log(smoothness * kernels)
        shapes.append(shape)
    return shapes


def _shape_places(terms: Terms) -> list[int]:
    """Index in the shape of their prior at which that of each term begins."""
    counts = [len(term.prior().start) for term in terms]
    # between two terms there is the ratio of their amplitudes, from the second on
    return [sum(counts[:index]) + max(index - 1, 0) for index in range(len(terms))]


def cost(terms: Terms, response: ForceResponse) -> float:
    """Cost of the numbers of the geometry: a prior of unit information each."""
    count = sum(leaf.size for term in terms for leaf in term.geometry)
    return 0.5 * count * float(np.log(response.num_free)) + 3.0 * len(terms)


def polish(terms: Terms, response: ForceResponse) -> Proposal | None:
    """Profiles and geometry of the highest evidence; None where there is no best.

    Profiles come first: a geometry has no derivative while its profile is zero.
    """
    try:
        terms = with_profiles(terms, response)
        force, shaped = SumForce(terms), any(term.geometry for term in terms)
        problem = Regression.of(
            force,
            response,
            weights=_weights,
            weights_prior=GaussianWeights(prior_of(terms), ROUGHLY),
            constants=_geometry,
            step_rule=FullStep(),
            is_linear=not shaped,
            num_projected=response.num_projected,
            linearisation=response.linearise,
        )
        # Without bounds that of a term of no weight would not be determined.
        reach = [scale for term in terms for scale in term.geometry_scales]
        priors = wide_priors(problem.parametric, problem.theta, _geometry, reach)
        problem = dataclasses.replace(problem, priors=priors)
        _, steps = iterate(problem, POLICY.polish_steps)
    except FitError:
        return None
    steps.sort(key=lambda step: step.hyperparameters.log_evidence, reverse=True)
    for best in steps:
        fitted = problem.parametric.at(best.move.theta)
        if all(_is_in_reach(term, response) for term in fitted.terms):
            break
    else:
        return None
    chosen = best.hyperparameters
    value = (
        float(chosen.log_evidence)
        - _determined_heights(best, priors)
        - cost(terms, response)
    )
    if not np.isfinite(value):
        return None
    scales = tuple(
        float(np.exp(chosen.shape[place])) if _has_kernels(term) else np.inf
        for term, place in zip(terms, _shape_places(terms), strict=True)
    )
    return Proposal(fitted.terms, value, chosen.noise, scales)


def _determined_heights(step: Step, priors: ConstantPriors) -> float:
    """Part of the evidence already charged for the numbers that `cost` charges.

    That of a number which the data determine is the same for angles and for places. One
    that they leave open costs what its prior allows as well: its term is needless.
    """
    deviations = np.sqrt(np.diag(step.covariance)[list(priors.entries)])
    heights = [
        prior.log_height
        for prior, deviation in zip(priors.priors, deviations, strict=True)
        if prior.standard_score(deviation) - prior.standard_score(0.0) < OPEN
    ]
    return float(sum(heights))


OPEN = 0.5
"""Deviation of a number of the geometry, relative to that of its prior, above which the
data leave it open."""


def _is_in_reach(term: AbstractTerm, response: ForceResponse) -> bool:
    """True if the kernels of a profile reach most of the data.

    Otherwise no parameter of the term is determined, and the integral over its geometry
    is no evidence.
    """
    if not isinstance(term, AbstractProfileTerm) or term.law is not None:
        return True
    z = np.asarray(coordinates(term, response.points))
    z = z.reshape(-1, z.shape[-1])
    reach = float(np.max(term.places)) + float(term.width)
    return bool(np.mean(np.abs(z).min(axis=-1) < reach) > POLICY.reached)


@eqx.filter_jit
def coordinates(
    term: AbstractProfileTerm, points: Float[Array, "trajectory group dim"]
) -> Float[Array, "trajectory group coordinate"]:
    """Coordinates of a term at the points of a response [L]."""
    return jax.vmap(jax.vmap(term.coordinates))(points)
