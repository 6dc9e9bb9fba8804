"""A survey of data: their response to any force."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pinav.fitting.engine.evidence_fit import EvidenceFit
from pinav.fitting.evidence.evidence import LinearisedObservations, at_shape
from pinav.fitting.policy import POLICY
from pinav.fitting.structure.fits import Fits
from pinav.fitting.structure.response import (
    ForceResponse,
    force_quadratic,
    force_response,
    parts_of,
)
from pinav.fitting.structure.search import Search, refine, simplify
from pinav.fitting.structure.starts import Region
from pinav.fitting.structure.trace import Trace
from pinav.fitting.structure.trials import Proposal
from pinav.forces import (
    AbstractLearnedForce,
    ZeroForce,
    as_learned_force,
    split_structure,
)
from pinav.trajectories import Trajectories


class Survey(eqx.Module):
    """Response of the data to any force, linearised about a fit or smoothed states.

    Attributes:
        is_begun: True if the states are those of a fit, not smoothed ones.
        log_evidence: of the free kernels of that fit in these data, to which that of
            terms compares [nats]; minus infinity where terms stood beside them.
    """

    response: ForceResponse
    region: Region
    noise: float
    is_begun: bool
    log_evidence: float
    trace: Trace = eqx.field(static=True)

    @classmethod
    def of(cls, fits: Fits, fit: EvidenceFit | None = None) -> "Survey":
        """The survey of the data of fits.

        Args:
            fit: about which the data are linearised; about the states with which fits
                begin, and no force, unless given.
        """
        specification = fits.specification
        problem = (fits if fit is None else fits.about(fit)).problem()
        data, dim = specification.trajectories, specification.dim
        states = problem.states if fit is None else fit.states
        still = eqx.tree_at(lambda m: m.environment, specification.model, ZeroForce())
        if states is None:
            raise ValueError("Survey.of: expected a problem with states")
        chosen = POLICY.looked_at(len(data), dim)
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
            log_evidence=-np.inf if fit is None else _evidence_of(fit, response),
            trace=fits.trace,
        )

    def explains(self, proposal: Proposal) -> bool:
        """True if terms leave little more than the noise, and no more than kernels do.

        A field without any structure is explained by many flexible terms, too, but
        better by free kernels.
        """
        is_better = proposal.log_evidence > self.log_evidence - POLICY.clear
        return is_better and proposal.noise <= POLICY.explained * self.noise

    def is_worth_a_fit(self, proposal: Proposal) -> bool:
        """True if the terms may explain the data about their own fit.

        Smoothed states miss the path, so that right terms leave more about them; in
        space such terms are not worth the time of a fit.
        """
        if self.is_begun or not self.region.is_planar:
            return self.explains(proposal)
        return proposal.noise <= POLICY.hopeless * self.noise

    def propose(self, search: Search, *, singles_only: bool = False) -> list[Proposal]:
        """Proposals that are worth a fit, those preferred by the evidence first.

        About states of a fit that explains the data the right terms explain them, too.

        Args:
            search: of this survey.
        """
        proposals = search.run(singles_only=singles_only)
        proposals = [one for one in proposals if self.is_worth_a_fit(one)]
        proposals[:1] = [self.simplify(one) for one in proposals[:1]]
        if not self.region.is_planar:
            # The kernels of the search are half as many there as those of a fit.
            return [refine(one, self.response, 1) for one in proposals]
        if self.is_begun and proposals:
            # What the kernels of profiles are too coarse for, their laws may carry.
            finest = refine(proposals[0], self.response)
            proposals = proposals if self.explains(finest) else proposals[1:]
        return proposals

    def simplify(self, proposal: Proposal) -> Proposal:
        """A proposal without what these data do not ask for."""
        simpler = simplify(proposal, self.response, self.region)
        left = simpler.noise / self.noise
        self.trace.note(simpler.terms, "preferred", simpler.log_evidence, left)
        return simpler

    def search(self, *, rotational: bool, content: float = POLICY.content) -> Search:
        """The search for terms in these data.

        Smoothed states miss the path of quick swimmers, and a term that is right may
        leave a few times the noise: about them it ends the search.
        """
        return Search(
            self.response,
            self.region,
            self.noise,
            rotational,
            content if self.is_begun else POLICY.hopeless,
            self.log_evidence - POLICY.clear,
            self.trace,
        )


def survey_about(
    fits: Fits, free: EvidenceFit | None, survey: Survey
) -> tuple[Fits, Survey]:
    """A survey about free kernels, and fits from there, where they explain the data.

    Args:
        free: their fit, if there is one.
        survey: about smoothed states, which stays where they do not.
    """
    if free is None or free.hyperparameters.noise > POLICY.explained * survey.noise:
        return fits, survey
    return fits.about(free), Survey.of(fits, free)


def _evidence_of(fit: EvidenceFit, response: ForceResponse) -> float:
    """Log evidence of the free kernels of a fit in the data linearised about it."""
    kernels = fit.model.environment
    if split_structure(kernels)[0]:
        return -np.inf
    data = LinearisedObservations.of(force_quadratic(parts_of(kernels), response))
    shape = fit.hyperparameters.shape
    return at_shape(data, kernels.prior().covariance, shape).log_evidence


DIMENSIONS = 2, 3
"""Dimensions of the spaces in which a structure is sought."""


def is_worth_a_search(model: Any, trajectories: Trajectories) -> bool:
    """True if the data could tell a structure of a force that does not change.

    A network is told of it by a teacher whose force does not change.
    """
    has_teacher = is_network(model) and model.environment.dim in DIMENSIONS
    return (
        (has_teacher or _static_field(model) is not None)
        and len(trajectories) >= POLICY.least_data[0]
        and trajectories.num_observed >= POLICY.least_data[1]
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
    if force is None or force.kernels is None or force.dim not in DIMENSIONS:
        return None
    return force if force.is_static else None
