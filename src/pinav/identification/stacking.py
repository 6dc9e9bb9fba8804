"""The average of two models' paths, weighted by rollouts of the training part."""

import numpy as np
from jaxtyping import Float

from pinav.identification.forecast import Displacement, Rollouts, changes_along
from pinav.identification.tracks import Track

HORIZON = 10.0
"""Length of the rollouts that tell the weight [s]."""

PRIOR_ROLLOUTS = 15
"""Rollouts that the wish for equal weights counts as."""


def stacking_weight(track: Track, ours: Displacement, theirs: Displacement) -> float:
    """Weight of one model beside another one, from 0 to 1.

    The ends of rollouts, relative to the length of the path, are fitted by least
    squares. The training part flatters the richer model, and few rollouts say little:
    weights are drawn to one half, which they are without any rollout.

    Args:
        track: the training part of both.
        ours: the model whose weight it is.
        theirs: the other one.
    """
    rollouts = Rollouts.of(track, HORIZON)
    other = changes_along(track, rollouts, theirs)
    length = np.maximum(rollouts.lengths(track), 1e-12)[:, None]
    apart = (changes_along(track, rollouts, ours) - other) / length
    observed = changes_along(track, rollouts, lambda piece: piece.states)
    wanted = (observed - other) / length
    return _shrink_weight(apart, wanted)


def _shrink_weight(
    apart: Float[np.ndarray, "rollout 2"], wanted: Float[np.ndarray, "rollout 2"]
) -> float:
    squares = float(np.sum(apart**2))
    if squares == 0:
        return 0.5
    prior = PRIOR_ROLLOUTS * squares / len(apart)
    weight = (np.sum(apart * wanted) + 0.5 * prior) / (squares + prior)
    return float(np.clip(weight, 0.0, 1.0))


def stack(ours: Displacement, theirs: Displacement, weight: float) -> Displacement:
    """The average of two paths; `weight` is that of the first."""
    return lambda piece: weight * ours(piece) + (1 - weight) * theirs(piece)
