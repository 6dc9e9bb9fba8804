"""Fits of trajectories in pieces, where no force follows them whole.

A rollout is a strong constraint: what kernels cannot represent, such as a jump, misses
the rest of a trajectory, and where paths are unstable by more than the field is wide.
In pieces, each with a start of its own, the force is determined by what it does at
once. A right model leaves the same noise in pieces as in halves of them.
"""

import dataclasses
from collections.abc import Callable

from pinav.errors import FitError
from pinav.fitting.bayes.neural import FitSpecification
from pinav.fitting.engine.evidence_fit import (
    EvidenceFit,
    EvidenceProgress,
    evidence_fit,
)
from pinav.fitting.environments.refinement import Refinement, iterate_refined
from pinav.fitting.outcome import Outcome
from pinav.fitting.policy import POLICY
from pinav.trajectories import halve, join_halves

SHORTEST = 8
"""Samples of a piece at least: a start takes the numbers of two."""


def fit_pieces(
    specification: FitSpecification,
    whole: EvidenceFit,
    refine: Refinement | None,
    max_iterations: int,
    on_step: Callable[[EvidenceProgress], None] | None = None,
) -> EvidenceFit:
    """The fit of kernels to the longest pieces that they explain, as a `MISFIT`.

    Args:
        whole: the fit of the same kernels that diverged.

    Returns:
        The fit, with states of the whole trajectories that are not continuous from
        piece to piece; `whole` where even the shortest pieces diverge.
    """
    data = specification.trajectories
    halves = halve(data, SHORTEST)
    if len(halves) == len(data):
        return whole
    inner = dataclasses.replace(specification, trajectories=halves)
    try:
        problem, outcome, steps = iterate_refined(
            inner.problem(inner.model),
            inner.problem,
            refine,
            halves,
            max_iterations,
            on_step,
        )
        fit = evidence_fit(problem, outcome, steps, not_finite="", advice={})
    except FitError:  # its first linearisation is not finite
        return whole
    is_same = fit.hyperparameters.noise > whole.hyperparameters.noise / (
        1 + POLICY.same
    )
    if whole.outcome is not Outcome.DIVERGED and is_same:
        return whole
    fit = fit_pieces(inner, fit, refine, max_iterations, on_step)
    if fit.outcome is Outcome.DIVERGED:
        return whole
    assert fit.states is not None
    states = join_halves(fit.states, data, SHORTEST)
    return dataclasses.replace(fit, outcome=Outcome.MISFIT, states=states)
