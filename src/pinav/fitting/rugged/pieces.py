"""Fits of trajectories in pieces, where no force follows them whole.

A rollout is a strong constraint: what kernels cannot represent, such as a jump of the
force, misses all of a trajectory that comes after it. In pieces, each with a start of
its own, the force is determined by what it does at once. Pieces are short enough where
halves of them leave the same noise, as they do of any trajectory under a right model.
"""

import dataclasses

from pinav.errors import FitError
from pinav.fitting.engine.evidence_fit import EvidenceFit
from pinav.fitting.outcome import Outcome
from pinav.fitting.policy import POLICY
from pinav.fitting.rugged.free import fit_rough
from pinav.fitting.structure.fits import Fits
from pinav.trajectories import halve, join

SHORTEST = 8
"""Samples of a piece at least: its start has the numbers of two."""


def fit_pieces(fits: Fits, whole: EvidenceFit) -> EvidenceFit:
    """The fit of kernels to the longest pieces that they explain: a `MISFIT`.

    Once the time of the search is over, the kernels stay as they are.

    Args:
        whole: the fit of the same data that diverged.

    Returns:
        The fit, with states that jump from piece to piece; `whole` where no pieces
        converge.
    """
    data = fits.specification.trajectories
    cut, least = fits.to(data), float("inf")
    while True:
        pieces = cut.specification.trajectories
        halves = halve(pieces, SHORTEST)
        if len(halves) == len(pieces):
            break
        begun = fits.to(halves).begin()
        noise = float("inf") if begun is None else begun.hyperparameters.noise
        if noise > least / (1 + POLICY.same):
            break
        cut, least = fits.to(halves), noise
    try:
        fit = cut.fit() if fits.trace.is_over else fit_rough(cut)
    except FitError:  # nothing is finite
        return whole
    if fit.outcome is Outcome.DIVERGED or fit.states is None:
        return whole
    states = join(fit.states, pieces, data)
    return dataclasses.replace(fit, outcome=Outcome.MISFIT, states=states)
