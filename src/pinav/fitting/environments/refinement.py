r"""Kernels as fine as the evidence asks for.

A field cannot vary faster than the kernels that it is made of. Where the data want it
to, the evidence drives the length scale $\ell$ of the weights below the width $b$ of a
kernel, and no weights repair the misfit: the kernels are then too coarse. With
$\ell \ge b$ the prior, not the grid, limits the field, and finer kernels change little.
"""

from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from pinav.errors import InputError
from pinav.fitting.environments.kernels import KernelGrid, kernel_environment
from pinav.fitting.evidence.priors import LOG_RATIO, kernel_prior
from pinav.forces import (
    ChangingPotential,
    KernelForce,
    KernelMixture,
    KernelPotential,
    KernelStream,
)
from pinav.trajectories import Trajectories

SINGLE = KernelForce | KernelPotential | KernelStream
"""Static environments of kernels on one grid."""

Gridded = SINGLE | KernelMixture | ChangingPotential
"""Environments whose kernels can be laid anew."""


class Refinement(eqx.Module):
    r"""When kernels are laid anew, closer to each other, and how far that may go.

    Attributes:
        factor: by which their spacing and width shrink.
        shortest: length scale $\ell$ of the prior, in widths, below which kernels are
            too coarse.
        max_weights: weights at most. A step costs the square of their number, the
            search for the shape of their prior the cube.

    Raises:
        InputError: `factor` is not greater than one, or another number not positive.
    """

    factor: float = 1.5
    shortest: float = 1.0
    max_weights: int = 2000

    def __check_init__(self):
        for name, least in (("factor", 1), ("shortest", 0), ("max_weights", 0)):
            if not getattr(self, name) > least:
                raise InputError(
                    f"Refinement.{name}: expected > {least}, got {getattr(self, name)}"
                )

    def wanted(self, environment: Any, shape: Float[np.ndarray, " shape"]) -> bool:
        """Whether the kernels are too coarse; never without a grid of kernels to learn.

        Args:
            environment: what was fitted.
            shape: of its prior (`kernel_prior`), as the evidence chose it; empty where
                its weights were known.
        """
        if not isinstance(environment, Gridded) or not len(shape):
            return False
        return min(length_scales(environment, shape)) < self.shortest

    def finer(self, environment: Gridded, trajectories: Trajectories) -> Gridded | None:
        """The untrained environment on a finer grid; None where it has no room.

        Its kernels are as far apart as they are wide, and reach as far beyond the data
        as those of `KernelGrid()`. The part that changes with time stays as it is.

        Args:
            environment: one whose kernels are too coarse.
            trajectories: what it is fitted to.
        """
        static, kind = _static(environment)
        dim = np.shape(static.centers)[1]
        seen = trajectories.observed[..., :dim].all(axis=-1)
        extent = np.ptp(trajectories.states[..., :dim][seen], axis=0).max()
        grid = KernelGrid(across=round(self.factor * extent / float(static.width)))
        made: Any = kernel_environment(kind, trajectories, grid, dim=dim)
        if isinstance(environment, ChangingPotential):
            made = ChangingPotential(made, environment.change)
        count = sum(leaf.size for leaf in jax.tree.leaves(made.parameters))
        return made if count <= self.max_weights else None


AS_FINE_AS_ASKED = Refinement()
"""Unless a fit is told otherwise."""


def length_scales(
    environment: Gridded, shape: Float[np.ndarray, " shape"]
) -> list[float]:
    r"""Length scale $\ell$ of each part that has a say, in widths of its kernels.

    A part whose amplitude is the lowest that is sought is absent: nothing depends on
    its length scale. Nor does the grid of a change in time follow its length scale.
    """
    first = float(np.exp(shape[0]))
    if isinstance(environment, SINGLE):
        return [first]
    ratio = shape[-1]
    own = [first] if ratio < ABSENT else []
    if isinstance(environment, KernelMixture) and ratio > -ABSENT:
        second = len(kernel_prior(environment.gradient).start)
        own.append(float(np.exp(shape[second])))
    return own or [np.inf]


ABSENT = 0.5 * LOG_RATIO
"""Logarithm of a ratio of amplitudes at which one part is all there is."""


def _static(environment: Gridded) -> tuple[SINGLE, type]:
    """The part that does not change with time, and the kind of the whole of it."""
    if isinstance(environment, KernelMixture):
        return environment.gradient, KernelMixture
    if isinstance(environment, ChangingPotential):
        return environment.static, KernelPotential
    return environment, type(environment)
