r"""`fit_structured`: a free fit, and the structure that the evidence prefers to it.

The structure is sought first, because it costs seconds and spares the refinement of
kernels where it explains the data; then the free field is fitted, and the structured
one, each with its own engine run on the same data. The one of higher evidence is the
result. A structured force keeps free kernels beside its terms.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np

from pinav.dynamics import FixedStep, Swimmer
from pinav.errors import FitError
from pinav.fitting.bayes.fit_bayes import ADVICE, NOT_FINITE
from pinav.fitting.bayes.neural import FitSpecification
from pinav.fitting.bayes.parameters import Learn
from pinav.fitting.bayes.problem import BayesProblem
from pinav.fitting.engine.evidence_fit import EvidenceFit, evidence_fit
from pinav.fitting.engine.iterate import EvidenceProgress, iterate
from pinav.fitting.engine.problem import Step
from pinav.fitting.environments.refinement import (
    AS_FINE_AS_ASKED,
    Refinement,
    iterate_refined,
)
from pinav.fitting.evidence.model_evidence import DECISIVE, model_evidence
from pinav.fitting.outcome import Outcome
from pinav.fitting.structure.proposals import Proposal, propose
from pinav.fitting.structure.response import force_response
from pinav.fitting.structure.starts import Region
from pinav.forces import (
    KernelForce,
    KernelMixture,
    KernelPotential,
    StructuredForce,
    ZeroForce,
)
from pinav.trajectories import Trajectories, with_velocities

LEAST_TRAJECTORIES, LEAST_SAMPLES = 6, 600
"""Trajectories and observed numbers below which data are not worth a search."""

MOST_TRAJECTORIES = 32
"""Trajectories that a search looks at; the fits see all."""

EXPLAINED = 1.5
"""Misfit of a proposal, relative to the noise, above which it is not fitted: its free
remainder would have to carry too much."""


class StructuredFit(eqx.Module):
    """A fit, and what the search for structure came to.

    Attributes:
        fit: the result, structured or free.
        gain: log evidence of the structured force over the free one on the kernels with
            which fits begin [nats]; NaN where no structure was fitted.
    """

    fit: EvidenceFit
    gain: float

    @property
    def structure(self) -> StructuredForce | None:
        """The structured force, where one was preferred."""
        environment = self.fit.model.environment
        return environment if isinstance(environment, StructuredForce) else None


def fit_structured(
    model: Any,
    trajectories: Trajectories,
    *,
    learn: Learn = lambda _: (),
    noise: float | None = None,
    solver: FixedStep | None = None,
    max_iterations: int = 20,
    on_step: Callable[[EvidenceProgress], None] | None = None,
    throw: bool = True,
) -> StructuredFit:
    """Fit kernels, and a structured force where the data show one; see `fit_bayes`.

    Args:
        model: dynamics whose environment is a `KernelPotential`, a `KernelForce` or a
            `KernelMixture`.
        trajectories: what was observed.
        learn: constants to learn too.
        noise: standard deviation of the observations; estimated unless given.
        solver: steps between samples; `FixedStep()` unless given.
        max_iterations: after which a fit counts as stalled.
        on_step: called after each step.
        throw: raise where the fit did not converge.

    Raises:
        FitError: as `fit_bayes` does.
    """
    if isinstance(model, Swimmer):
        trajectories = with_velocities(trajectories)
    with jax.enable_x64(new_val=True):
        solver = FixedStep() if solver is None else solver
        specification = FitSpecification(model, trajectories, learn, noise, solver)
        free = specification.problem(model)
        proposal = _proposal(specification, free)

        def ended(problem: BayesProblem, refine: Refinement | None) -> EvidenceFit:
            how = iterate_refined(
                problem,
                specification.problem,
                refine,
                trajectories,
                max_iterations,
                on_step,
            )
            advice = ADVICE if throw else {}
            return evidence_fit(*how, not_finite=NOT_FINITE, advice=advice)

        if proposal is None:
            return StructuredFit(ended(free, AS_FINE_AS_ASKED), np.nan)
        return _better(specification, free, proposal, ended, max_iterations, on_step)


def is_worth_a_search(model: Any, trajectories: Trajectories) -> bool:
    """Whether the data could tell a structure, in a plane and of static kernels."""
    environment = model.environment
    return (
        isinstance(environment, KernelPotential | KernelForce | KernelMixture)
        and environment.dim == 2
        and len(trajectories) >= LEAST_TRAJECTORIES
        and trajectories.num_observed >= LEAST_SAMPLES
    )


def _proposal(specification: FitSpecification, free: BayesProblem) -> Proposal | None:
    """The structure that explains the linearised data nearly to the noise, if any."""
    model, data = specification.model, specification.trajectories
    if free.states is None or not is_worth_a_search(model, data):
        return None
    chosen = slice(None, None, -(-len(data) // MOST_TRAJECTORIES))
    observations = jax.tree.map(lambda leaf: leaf[chosen], free.observations)
    response = force_response(
        eqx.tree_at(lambda m: m.environment, model, ZeroForce()),
        free.states[chosen],
        observations,
        specification.solver,
        specification.dim,
    )
    is_observed = data.observed[..., : specification.dim].all(axis=-1)
    region = Region.of(data.states[..., : specification.dim][is_observed])
    noise = free.first_noise if specification.noise is None else specification.noise
    turning = not model.environment.is_conservative
    proposal = propose(response, region, noise, rotational=turning)
    if proposal is None or not proposal.noise < EXPLAINED * noise:
        return None
    return proposal


def _better(
    specification: FitSpecification,
    free: BayesProblem,
    proposal: Proposal,
    ended: Callable[[BayesProblem, Refinement | None], EvidenceFit],
    max_iterations: int,
    on_step: Callable[[EvidenceProgress], None] | None,
) -> StructuredFit:
    """The free fit or the structured one, by their evidence."""
    model = specification.model
    force = StructuredForce(proposal.terms, model.environment)
    start = eqx.tree_at(lambda m: m.environment, model, force)
    try:
        structured = ended(specification.problem(start), None)
    except FitError:
        structured = None
    if structured is None or structured.outcome is Outcome.DIVERGED:
        return StructuredFit(ended(free, AS_FINE_AS_ASKED), np.nan)

    def is_coarse(step: Step) -> bool:
        shape = step.hyperparameters.shape
        return AS_FINE_AS_ASKED.is_needed(model.environment, shape)

    outcome, steps = iterate(free, max_iterations, on_step, is_coarse)
    alone = evidence_fit(free, outcome, steps, not_finite=NOT_FINITE, advice={})
    gain = _evidence(structured) - _evidence(alone)
    if gain > DECISIVE:
        return StructuredFit(structured, gain)
    if outcome is Outcome.CONVERGED and not is_coarse(steps[-1]):
        return StructuredFit(alone, gain)
    return StructuredFit(ended(free, AS_FINE_AS_ASKED), gain)


def _evidence(fit: EvidenceFit) -> float:
    return model_evidence(fit.linear, fit.hyperparameters).log_evidence
