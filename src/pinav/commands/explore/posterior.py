"""The posterior of a run as the page draws from it: few directions of many."""

import numpy as np
from jaxtyping import Float

from pinav.fitting import Posterior

NUMBERS = 130_000
"""Numbers of the factor at most: 0.7 MB of a page of at most 1.5 MB."""

FEW = 64
"""Directions that are all kept, without asking which of them matter."""

NEGLIGIBLE = 1e-7
"""Share of the variance below which a direction is left out."""

GRID = 25
"""Points along each side on which directions are weighed."""


def directions(
    posterior: Posterior,
    box: tuple[float, float, float, float],
    times: tuple[float, ...] = (0.0,),
) -> tuple[Float[np.ndarray, "parameter direction"], float]:
    r"""A factor $L$ of the covariance, $\Sigma \approx L L^\top$, and what it keeps.

    Most of the variance of weights has no effect. Kept are the directions that matter
    most for the force on a grid, the leading right singular vectors of
    $D^{-1} J \Sigma^{1/2}$ with the Jacobian $J$ of the force. $D$ holds the standard
    deviations of the force, so that places where it is well known count as much as
    those where it is not; each constant that does not enter the force counts as one
    place.

    Args:
        posterior: of the model.
        box: where the force is weighed, x from and to, y from and to [L].
        times: at which it is weighed [T].

    Returns:
        The factor, with at most `NUMBERS` numbers, and the share of the relative
        variance on the grid that it keeps.
    """
    values, vectors = np.linalg.eigh(posterior.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    if len(root) <= FEW:
        return root, 1.0
    x, y = np.linspace(*box[:2], GRID), np.linspace(*box[2:], GRID)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    rows = np.concatenate(
        [posterior.force_jacobians(points, t).reshape(-1, len(root)) for t in times]
    )
    silent = np.abs(rows).max(axis=0) == 0
    relative = np.concatenate([rows @ root, root[silent]])
    spread = np.linalg.norm(relative, axis=1, keepdims=True)
    relative = relative / np.where(spread > 0, spread, 1.0)
    variances, right = np.linalg.eigh(relative.T @ relative)
    variances, right = np.maximum(variances[::-1], 0.0), right[:, ::-1]
    matter = int(np.sum(variances > NEGLIGIBLE * variances.sum()))
    keep = min(max(NUMBERS // len(root), 1), matter)
    kept = float(variances[:keep].sum() / variances.sum())
    return root @ right[:, :keep], kept
