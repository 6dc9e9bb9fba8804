r"""A survey of the data's response to forces, and the evidence of a rotational part.

A `KernelMixture` holds a stream function beside the potential, and a prior that may
send it to nothing. The two are compared in one and the same linear problem: once before
any fit, about the smoothed states, where the comparison costs no dynamics; and about
the states of a fitted mixture, where it is that of the fits near the decision.
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pinav.errors import FitError
from pinav.fitting.bayes.neural import FitSpecification
from pinav.fitting.bayes.problem import BayesProblem
from pinav.fitting.engine.evidence_fit import EvidenceFit
from pinav.fitting.evidence.evidence import (
    LinearisedObservations,
    at_shape,
    best_hyperparameters,
)
from pinav.fitting.evidence.model_evidence import (
    DECISIVE,
    LinearFit,
    model_evidence,
)
from pinav.fitting.evidence.quadratic import restrict
from pinav.fitting.evidence.weights import GaussianWeights
from pinav.fitting.structure.candidates import ENOUGH, EXPLAINED, HOPELESS
from pinav.fitting.structure.proposals import is_hopeless, propose, refine
from pinav.fitting.structure.response import (
    ForceResponse,
    force_quadratic,
    force_response,
)
from pinav.fitting.structure.starts import GRID, Region
from pinav.fitting.structure.trials import Proposal, Terms
from pinav.forces import (
    AbstractLearnedForce,
    KernelMixture,
    KernelPlaces,
    KernelPotential,
    StructuredForce,
    ZeroForce,
    as_learned_force,
    split_structure,
)
from pinav.trajectories import Trajectories

MOST_TRAJECTORIES = {2: 32, 3: 10}
"""Trajectories that a survey looks at, by the dimension of space, in which many more
places are scanned; the fits see all."""


class Survey(eqx.Module):
    """Response of the data to any force, linearised about their smoothed states.

    Attributes:
        is_begun: True if the states are those of a fit, not smoothed ones.
    """

    response: ForceResponse
    region: Region
    noise: float
    is_begun: bool

    @classmethod
    def of(
        cls,
        specification: FitSpecification,
        problem: BayesProblem,
        fit: EvidenceFit | None = None,
    ) -> "Survey":
        """The survey of the data of a fit.

        Args:
            fit: about which the data are linearised; about the smoothed states and no
                force unless given.
        """
        data, dim = specification.trajectories, specification.dim
        states = problem.states if fit is None else fit.states
        still = eqx.tree_at(lambda m: m.environment, specification.model, ZeroForce())
        if states is None:
            raise ValueError("Survey.of: expected a problem with states")
        chosen = slice(None, None, -(-len(data) // MOST_TRAJECTORIES[dim]))
        response = force_response(
            still if fit is None else fit.model,
            jnp.asarray(states)[chosen],
            jax.tree.map(lambda leaf: leaf[chosen], problem.observations),
            specification.solver,
            dim,
        )
        is_observed = data.observed[..., :dim].all(axis=-1)
        given = specification.noise
        return cls(
            response=response,
            region=Region.of(data.states[..., :dim][is_observed]),
            # Smoothed states miss a path that a thrust turns at once.
            noise=min(problem.first_noise, response.least_noise)
            if given is None
            else given,
            is_begun=fit is not None,
        )

    def proposal(self, *, rotational: bool, enough: float = ENOUGH) -> Proposal | None:
        """The structure that explains most of the data, if it comes near the noise.

        In space one that explains them but roughly is not worth the time of its fit.
        Smoothed states miss the path of quick swimmers, and a term that is right may
        leave a few times the noise: it is not worth a search for others.
        """
        best = propose(
            self.response,
            self.region,
            self.noise,
            rotational=rotational,
            enough=enough if self.is_begun else HOPELESS,
        )
        if best is None or best.noise > HOPELESS * self.noise:
            return None
        if not self.is_near_noise(best):
            rough = dataclasses.replace(best, is_rough=True)
            return rough if self.region.is_planar else None
        # In space the kernels of the search are half as many as those of a fit.
        return best if self.region.is_planar else refine(best, self.response, 1)

    def is_hopeless(self, *, rotational: bool) -> bool:
        """True if no single term explains much of the data."""
        return is_hopeless(
            self.response, self.region, self.noise, rotational=rotational
        )

    def is_near_noise(self, proposal: Proposal) -> bool:
        """True if terms leave little more of the data unexplained than the noise."""
        return proposal.noise <= EXPLAINED * self.noise

    def is_at_noise(self, proposal: Proposal) -> bool:
        """True if terms leave so little of the data that they are all there is."""
        return proposal.noise <= AT_NOISE * self.noise

    def would_repeat(self, proposal: Proposal, again: Proposal | None) -> bool:
        """True if repeating the search here would return the same terms.

        The search ended with terms that are far from enough, so it left nothing
        untried, and their misfit in these data is the same.
        """
        is_same = again is not None and abs(again.noise / proposal.noise - 1) < SAME
        return is_same and not self.is_near_noise(proposal)


SAME = 0.1
"""Change of the misfit of terms, relative to it, that is none."""

AT_NOISE = 1.1
"""Misfit of terms about their own fit, relative to the noise, above which there is more
than these terms."""

LEAST_TRAJECTORIES, LEAST_SAMPLES = 6, 600
"""Trajectories and observed numbers below which data are not worth a search."""


def is_worth_a_search(model: Any, trajectories: Trajectories) -> bool:
    """True if the data could tell a structure of a force that does not change.

    A network is told of it by a teacher whose force does not change.
    """
    has_teacher = is_network(model) and model.environment.dim in GRID
    return (
        (has_teacher or _static_field(model) is not None)
        and len(trajectories) >= LEAST_TRAJECTORIES
        and trajectories.num_observed >= LEAST_SAMPLES
    )


def may_turn(model: Any) -> bool:
    """True if a rotational part can be weighed beside the potential of a model."""
    field = _static_field(model)
    return field is not None and field.is_conservative and field.dim == 2


def is_network(model: Any) -> bool:
    """True if the environment of a model is a network, which a teacher must show it."""
    force = as_learned_force(model.environment)
    return force is not None and not force.is_linear


def _static_field(model: Any) -> AbstractLearnedForce | None:
    """The force of a model where it is a field of kernels that does not change."""
    force = as_learned_force(model.environment)
    if force is None or force.kernels is None or force.dim not in GRID:
        return None
    return force if force.is_static else None


RATIOS = (-3.0, -1.0, 1.0)
"""Logarithms of the amplitude of a rotational part, relative to the potential, that are
tried before any fit."""


PLAIN = 3.0
"""Misfit of a potential, relative to that of a mixture, from which a rotation is plain.
Of fields with a potential, for which the kernels are too coarse, it is up to 2.1 (four
draws of each family, keys 40 to 46), of swirls 4.4 to 21."""


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
    response: ForceResponse,
    noise: float,
    terms: Terms,
    kernels: KernelPlaces,
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
    enough = EXPLAINED * noise
    is_needed = gain > DECISIVE and chosen.noise > enough
    is_plain = best.noise < min(enough, chosen.noise / PLAIN)
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
        LinearisedObservations.of(reduced.quadratic),
        prior,
        prior.start,
        linear.noise,
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


def _without_rotation(
    force: Any,
) -> tuple[AbstractLearnedForce, np.ndarray, int]:
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
