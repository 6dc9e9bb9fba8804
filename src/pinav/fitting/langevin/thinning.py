r"""The diffusion of thinned data: steps that are short and diffusive give the same.

The part of an increment that its mean does not explain is that of a martingale, so
that its sums over two or three intervals have the moments
$\tfrac12\langle r^2\rangle + \langle r r'\rangle = D\tau$ of longer steps, whatever
blur and error are. A memory of the motion, or smoothing over more than one interval,
shows as a ratio to the diffusion of all samples that is not one.
"""

import numpy as np
from jaxtyping import Float

from pinav.fitting.engine.posterior import Estimate
from pinav.fitting.langevin.checks import ThinnedDiffusion

BLOCKS = 40
"""Stretches of time whose scatter makes the standard deviation."""


def thinned_diffusion(
    residuals: list[Float[np.ndarray, "_ axis"]],
    expected: list[Float[np.ndarray, "_ axis"]],
    groups: tuple[tuple[int, ...], ...],
    every: int,
) -> tuple[ThinnedDiffusion, ...]:
    r"""Diffusion from every so many samples, relative to that of all.

    Args:
        residuals: increments of each track less their mean, in the order of time [L].
        expected: $D\tau$ of each of them [L²].
        groups: the axes that share a diffusion.
        every: how many intervals make a step.

    Returns:
        Nothing where there are too few steps.
    """
    moments, motions = [], []
    for r, d in zip(residuals, expected, strict=True):
        count = len(r) // every
        if count > 1:
            shape = count, every, r.shape[1]
            steps = r[: count * every].reshape(shape).sum(axis=1)
            # a last step has no neighbour after it, and counts as none
            moments.append((0.5 * steps**2)[:-1] + steps[:-1] * steps[1:])
            motions.append(d[: count * every].reshape(shape).sum(axis=1)[:-1])
    if sum(map(len, moments)) < 2 * BLOCKS:
        return ()
    above, below = np.concatenate(moments), np.concatenate(motions)
    return tuple(
        ThinnedDiffusion(every, tuple(axes), _ratio(above[:, axes], below[:, axes]))
        for axes in map(list, groups)
    )


def _ratio(
    above: Float[np.ndarray, "step axis"], below: Float[np.ndarray, "step axis"]
) -> Estimate:
    """Ratio of two sums, its deviation from the scatter of blocks."""
    starts = np.linspace(0, len(above), BLOCKS, endpoint=False).astype(int)
    ratio = above.sum() / below.sum()
    misses = np.add.reduceat((above - ratio * below).sum(axis=1), starts)
    return Estimate(float(ratio), float(np.sqrt((misses**2).sum()) / below.sum()))
