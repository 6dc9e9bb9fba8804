"""Kernel environments made from data, and the Gaussian-process prior of their weights.

A grid of radial basis functions of width b, whose weights have a squared-exponential
covariance, is a Gaussian process: the basis filters the weights.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.arguments import check_positive
from pinav.errors import InputError
from pinav.forces import (
    AbstractLearnedForce,
    ChangingPotential,
    KernelAxis,
    KernelBasis,
    KernelForce,
    KernelMixture,
    KernelPotential,
    KernelProfile,
    KernelStream,
    TimedKernelPotential,
    Warp,
    kernel_centers,
)
from pinav.trajectories import Trajectories

Kernel = TypeVar("Kernel", KernelForce, KernelPotential, KernelStream, KernelMixture)


class KernelGrid(eqx.Module):
    """How kernels are laid around the data.

    Attributes:
        across: grid intervals along the longest extent of the data.
        width: of a kernel, in intervals.
        margin: in which there are kernels beyond the data, in intervals.

    Raises:
        InputError: a number is not positive.
    """

    across: int = 12
    width: float = 1.0
    margin: float = 4.0

    def __check_init__(self) -> None:
        check_positive(self, "across", "width", "margin")


IN_TIME = KernelGrid(across=9, margin=2.0)
"""Fewer kernels: each of them has a weight for every spline in time."""

IN_SPACE = KernelGrid(across=23, margin=2.0)
"""The finest grid in space that is tried: that of a long, thin region has few kernels.
"""

MOST_WEIGHTS = 2000
"""Weights of kernels at most. A step costs the square of their number, the search for
the shape of their prior the cube. All other limits are shares of it."""

AT_FIRST = 0.35
"""Share of the weights with which a fit begins at most, unless a grid is given. A plane
never has as many; in space a twelfth of the extent makes thousands."""

OFTEN = 0.5
"""Share of them where many grids are tried, or the search would take hours: in
regressions on forces along exact paths, and of refined grids in space."""

CHANGING = 0.75
"""Share of them of a potential that changes with time, what stays included."""

POSSIBLE = 2.0
"""Share of them beyond which a fit is refused: one step would take hours."""

Make = Callable[[Float[np.ndarray, "kernel dim"], float], AbstractLearnedForce]
"""The environment of centres and width of kernels [L]."""


def kernel_environment(
    kind: type[Kernel],
    trajectories: Trajectories,
    grid: KernelGrid | None = None,
    *,
    dim: int | None = None,
) -> Kernel:
    """An untrained kernel environment on a grid around the data: no force at all.

    Unless given, the grid is as fine as a twelfth of the longer side of the data, the
    kernels are as wide as the grid is fine, and they reach four intervals beyond the
    samples: a prior must not end within its own length scale. In space the grid is the
    finest whose weights are at most the share `AT_FIRST` of `MOST_WEIGHTS`. That is
    where `fit_bayes` begins; it lays finer ones where the evidence asks for them
    (`Refinement`).

    Args:
        trajectories: their channels are positions, then as many velocities.
        grid: its fineness; `KernelGrid()` unless given.
        dim: how many of their channels are positions; those called x, y and z unless
            given.

    Raises:
        InputError: the observed positions are fewer than two, or all the same, or
            there are no `dim` channels.
    """
    positions = observed_positions(trajectories, dim)
    if grid is not None:
        return kind.with_zero_weights(*surround_with_kernels(positions, grid))
    made: Any = first_kernels(kind.with_zero_weights, positions)
    return made


def first_kernels(
    make: Make, positions: Float[np.ndarray, "position dim"]
) -> AbstractLearnedForce:
    """Kernels with which every fit begins, by data alone; see `kernel_environment`."""
    made, most = make(*surround_with_kernels(positions, KernelGrid())), AT_FIRST
    if num_weights(made) <= most * MOST_WEIGHTS:
        return made
    return finest_kernels(make, positions, int(most * MOST_WEIGHTS), IN_SPACE)


def finest_kernels(
    make: Make,
    positions: Float[np.ndarray, "position dim"],
    most: int,
    grid: KernelGrid,
) -> AbstractLearnedForce:
    """Kernels on the finest grid that has few weights, from a given one downwards.

    Args:
        positions: which the kernels surround [L].
        most: weights; there may be more on a grid of one interval.
        grid: the finest that is tried.
    """
    made = make(*surround_with_kernels(positions, grid))
    while num_weights(made) > most and grid.across > 1:
        grid = KernelGrid(grid.across - 1, grid.width, grid.margin)
        made = make(*surround_with_kernels(positions, grid))
    return made


def num_weights(environment: AbstractLearnedForce) -> int:
    """Number of weights of an environment."""
    leaves = jax.tree.leaves(eqx.filter(environment.parameters, eqx.is_array))
    return sum(leaf.size for leaf in leaves)


def check_size(environment: AbstractLearnedForce | None) -> None:
    """Refuse an environment with more weights than can be fitted.

    Raises:
        InputError: it has more than `POSSIBLE` allows.
    """
    count = 0 if environment is None else num_weights(environment)
    most = int(POSSIBLE * MOST_WEIGHTS)
    if count > most:
        raise InputError(
            f"environment: expected at most {most} weights, got {count}; lay "
            "fewer kernels, such as kernel_environment(..., KernelGrid(across=6)), or "
            "choose a potential, which has one weight for each kernel"
        )


def timed_kernel_environment(
    trajectories: Trajectories,
    *,
    grid: KernelGrid | None = None,
    intervals: int = 6,
    max_weights: int = int(CHANGING * MOST_WEIGHTS),
    dim: int | None = None,
) -> TimedKernelPotential:
    """An untrained potential that may change with time, on a grid around the data.

    The splines reach from the first time to the last. Where the weights would be too
    many, the grid in space is made coarser.

    Args:
        grid: its fineness at most; `IN_TIME` unless given.
        intervals: of the splines in time, positive.

    Raises:
        InputError: `intervals` is not positive, `max_weights` is less than 100 for
            each spline, or as `kernel_environment` does.
    """
    grid = IN_TIME if grid is None else grid
    splines = intervals + 3
    if intervals < 1 or max_weights < 100 * splines:
        raise InputError(
            "timed_kernel_environment: expected one or more intervals and 100 weights "
            f"for each of 3 splines more, got {intervals} and {max_weights}"
        )
    first, last = float(trajectories.times.min()), float(trajectories.times.max())

    def make(
        centers: Float[np.ndarray, "kernel dim"], width: float
    ) -> TimedKernelPotential:
        weights = jnp.zeros((len(centers), splines))
        return TimedKernelPotential(weights, jnp.asarray(centers), width, first, last)

    positions = observed_positions(trajectories, dim)
    made: Any = finest_kernels(make, positions, max_weights, grid)
    return made


def changing_environment(
    trajectories: Trajectories, *, intervals: int = 6, dim: int | None = None
) -> ChangingPotential:
    """An untrained potential with a static part, and a part that changes with time.

    Args:
        intervals: of the splines in time, positive.

    Raises:
        InputError: see `timed_kernel_environment`.
    """
    static = kernel_environment(KernelPotential, trajectories, dim=dim)
    left = int(CHANGING * MOST_WEIGHTS) - num_weights(static)
    change = timed_kernel_environment(
        trajectories, intervals=intervals, max_weights=left, dim=dim
    )
    return ChangingPotential(static, change)


def profile_environment(
    trajectories: Trajectories,
    axes: tuple[KernelAxis, ...],
    *,
    along: tuple[int, ...] | None = None,
    across: int = 24,
) -> KernelProfile:
    """An untrained force along some axes that depends on some coordinates.

    Args:
        trajectories: their channels are the positions alone.
        axes: the coordinates on which the force depends, each with its period or warp.
        along: components of the force; those of `axes` unless given.
        across: kernels across the data along each coordinate.

    Raises:
        InputError: as `KernelBasis.around` and `KernelProfile` do.
    """
    is_observed = trajectories.observed.all(axis=-1)
    basis = KernelBasis.around(axes, trajectories.states[is_observed], across=across)
    components = tuple(axis.index for axis in axes) if along is None else along
    return KernelProfile.with_zero_weights(
        basis, components, len(trajectories.channels)
    )


def warp_at_slow_end(trajectories: Trajectories, axis: int) -> Warp:
    """The warp of a coordinate that makes kernels fine where the motion is slow.

    A wall is where steps are shortest: the origin is that end of the data, the scale
    the size of a step there, below which no field can be resolved.

    Args:
        trajectories: their channels are the positions alone.

    Raises:
        InputError: fewer than a hundred samples follow one another.
    """
    parts = [piece.states[piece.observed.all(axis=1), axis] for piece in trajectories]
    places = np.concatenate([part[:-1] for part in parts])
    steps = np.concatenate([np.diff(part) for part in parts])
    if len(steps) < FEWEST:
        raise InputError(
            f"warp_at_slow_end: expected {FEWEST} or more steps, got {len(steps)}"
        )
    ends = []
    for end, tail in ((END, places < np.quantile(places, TAIL)), (1 - END, None)):
        inside = places > np.quantile(places, 1 - TAIL) if tail is None else tail
        size = float(np.sqrt(np.mean(steps[inside] ** 2)))
        ends.append((size, float(np.quantile(places, end))))
    scale, origin = min(ends)
    return Warp(origin, scale)


END, TAIL, FEWEST = 1e-3, 0.05, 100
"""Share of the samples beyond an end of the data, and of those near it; steps at
least."""


def observed_positions(
    trajectories: Trajectories, dim: int | None
) -> Float[np.ndarray, "position dim"]:
    """All positions that were observed [L]; see `kernel_environment`."""
    count = len(trajectories.channels)
    dim = dim or trajectories.dim or count // 2
    if not 0 < dim <= count:
        raise InputError(
            f"kernel_environment dim: expected 1 to {count}, as many as there are "
            f"channels, got {dim}"
        )
    is_observed = trajectories.observed[..., :dim].all(axis=-1)
    return trajectories.states[..., :dim][is_observed]


def surround_with_kernels(
    positions: Float[np.ndarray, "position dim"], grid: KernelGrid
) -> tuple[Float[np.ndarray, "kernel dim"], float]:
    """Centres and width of kernels on a grid around positions.

    Raises:
        InputError: there are not two different positions.
    """
    extent = float(np.ptp(positions, axis=0).max()) if len(positions) > 1 else 0.0
    if not extent > 0:
        raise InputError(
            "kernel_environment: expected two or more different observed positions"
        )
    spacing = extent / grid.across
    centers = kernel_centers(positions, spacing=spacing, margin=grid.margin * spacing)
    return centers, grid.width * spacing
