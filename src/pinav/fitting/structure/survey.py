"""A survey of the data, before a fit or about one: their response to forces."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from pinav.fitting.bayes.neural import FitSpecification
from pinav.fitting.bayes.problem import BayesProblem
from pinav.fitting.engine.evidence_fit import EvidenceFit
from pinav.fitting.structure.candidates import ENOUGH, EXPLAINED, HOPELESS
from pinav.fitting.structure.proposals import is_hopeless, propose, refine
from pinav.fitting.structure.response import ForceResponse, force_response
from pinav.fitting.structure.starts import GRID, Region
from pinav.fitting.structure.trials import Proposal
from pinav.forces import AbstractLearnedForce, ZeroForce, as_learned_force
from pinav.trajectories import Trajectories

MOST_TRAJECTORIES = {2: 32, 3: 10}
"""Trajectories that a survey looks at, by the dimension of space, in which many more
places are scanned; the fits see all."""


class Survey(eqx.Module):
    """What the data say of any force, linearised about their smoothed states.

    Attributes:
        response: of the observations to forces.
        region: where the observations are.
        noise: of the observations, roughly or as it was given.
        is_begun: whether the states are those of a fit, not smoothed ones.
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
            specification: what is asked of the fit.
            problem: its start, with smoothed states.
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

        Args:
            rotational: whether the force may have no potential.
            enough: misfit relative to the noise at which nothing else is sought.
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
        """Whether no single term explains much of the data.

        Args:
            rotational: whether the force may have no potential.
        """
        return is_hopeless(
            self.response, self.region, self.noise, rotational=rotational
        )

    def is_near_noise(self, proposal: Proposal) -> bool:
        """Whether terms leave little more of the data unexplained than the noise."""
        return proposal.noise <= EXPLAINED * self.noise

    def is_at_noise(self, proposal: Proposal) -> bool:
        """Whether terms leave so little of the data that they are all there is."""
        return proposal.noise <= AT_NOISE * self.noise

    def would_repeat(self, proposal: Proposal, again: Proposal | None) -> bool:
        """Whether the search that ended with terms would end with them here, too.

        It did where its terms were far from enough, so that it left nothing untried,
        and these data tell of them what those told.

        Args:
            proposal: the terms as they were found.
            again: their polish with these data.
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
    """Whether the data could tell a structure of a force that does not change.

    A network is told of it by a teacher whose force does not change.
    """
    has_teacher = is_network(model) and model.environment.dim in GRID
    return (
        (has_teacher or _static_field(model) is not None)
        and len(trajectories) >= LEAST_TRAJECTORIES
        and trajectories.num_observed >= LEAST_SAMPLES
    )


def may_turn(model: Any) -> bool:
    """Whether a rotational part can be weighed beside the potential of a model."""
    field = _static_field(model)
    return field is not None and field.is_conservative and field.dim == 2


def is_network(model: Any) -> bool:
    """Whether the environment of a model is a network, which a teacher must show it."""
    force = as_learned_force(model.environment)
    return force is not None and not force.is_linear


def _static_field(model: Any) -> AbstractLearnedForce | None:
    """The force of a model where it is a field of kernels that does not change."""
    force = as_learned_force(model.environment)
    if force is None or force.kernels is None or force.dim not in GRID:
        return None
    return force if force.is_static else None
