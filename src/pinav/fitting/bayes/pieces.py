"""Fits of trajectories in pieces, where no force follows them whole.

A rollout is a strong constraint: what kernels cannot represent, such as a jump of the
force, misses all of a trajectory that comes after it. In pieces, each with a start of
its own, the force is determined by what it does at once. Pieces are short enough where
halves of them leave the same noise, as they do of any trajectory under a right model.
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
from pinav.trajectories import Trajectories, halve, join

SHORTEST = 8
"""Samples of a piece at least: its start has the numbers of two."""


def fit_pieces(
    specification: FitSpecification,
    whole: EvidenceFit,
    refine: Refinement | None,
    max_iterations: int,
    on_step: Callable[[EvidenceProgress], None] | None = None,
) -> EvidenceFit:
    """The fit of kernels to the longest pieces that they explain: a `MISFIT`.

    Args:
        whole: the fit of the same kernels that diverged.

    Returns:
        The fit, with states that jump from piece to piece; `whole` where no pieces
        converge.
    """

    def fit(
        pieces: Trajectories, refine: Refinement | None, steps: int
    ) -> EvidenceFit | None:
        part = dataclasses.replace(specification, trajectories=pieces)
        begin = part.problem(part.model)
        try:
            ended = iterate_refined(begin, part.problem, refine, pieces, steps, on_step)
            made = evidence_fit(*ended, not_finite="", advice={})
        except FitError:  # nothing is finite
            return None
        return None if made.outcome is Outcome.DIVERGED else made

    data = pieces = specification.trajectories
    least = float("inf")
    while len(halves := halve(pieces, SHORTEST)) > len(pieces):
        begun = fit(halves, None, POLICY.first_steps)
        noise = float("inf") if begun is None else begun.hyperparameters.noise
        if noise > least / (1 + POLICY.same):
            break
        pieces, least = halves, noise
    best = fit(pieces, refine, max_iterations)
    if best is None or best.states is None:
        return whole
    states = join(best.states, pieces, data)
    return dataclasses.replace(best, outcome=Outcome.MISFIT, states=states)
