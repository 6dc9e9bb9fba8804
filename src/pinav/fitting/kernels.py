"""Kernel environments made from data, and the Gaussian-process prior of their weights.

A grid of radial basis functions of width b, whose weights have a squared-exponential
covariance, is a Gaussian process: the basis filters the weights.
"""

from typing import TypeVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.errors import InputError
from pinav.learned import KernelForce, KernelPotential, kernel_centers
from pinav.trajectories import Trajectories

Kernel = TypeVar("Kernel", KernelForce, KernelPotential)

KERNELS_ACROSS, MARGIN = 12, 3.0
"""Kernels along the longer side of the data, and kernels in the margin around them."""

JITTER = 1e-8
"""Relative variance that keeps the prior positive definite."""


def kernel_environment(kind: type[Kernel], trajectories: Trajectories) -> Kernel:
    """An untrained kernel environment on a grid around the data: no force at all.

    The grid is as fine as a twelfth of the longer side of the data, the kernels are as
    wide as the grid is fine, and they reach three spacings beyond the samples: the
    prior must not end within its own length scale.

    Args:
        kind: `KernelForce` or `KernelPotential`.
        trajectories: their channels are positions, then as many velocities.

    Raises:
        InputError: the observed positions are fewer than two, or all the same.
    """
    dim = len(trajectories.channels) // 2
    seen = trajectories.observed[..., :dim].all(axis=-1)
    positions = trajectories.states[..., :dim][seen]
    extent = float(np.ptp(positions, axis=0).max()) if len(positions) > 1 else 0.0
    if not extent > 0:
        raise InputError(
            "kernel_environment: expected two or more different observed positions"
        )
    spacing = extent / KERNELS_ACROSS
    centers = kernel_centers(positions, spacing=spacing, margin=MARGIN * spacing)
    shape = centers.shape if kind is KernelForce else centers.shape[:1]
    return kind(jnp.zeros(shape), jnp.asarray(centers), spacing)


def length_scales(
    environment: KernelForce | KernelPotential,
) -> Float[np.ndarray, " candidate"]:
    """Length scales [L] between which the evidence chooses: 1.45 to 6 widths."""
    return np.geomspace(1.45, 6.0, 12) * float(environment.width)


def weight_covariance(
    environment: KernelForce | KernelPotential, length_scale: float
) -> Float[np.ndarray, "weight weight"]:
    r"""Prior covariance of the weights, of unit amplitude, flattened as they are.

    The field has the length scale $\ell$ when the weights have $\ell_w$ with
    $\ell_w^2 = \ell^2 - 2 b^2$, because the basis adds its own width b twice.

    Args:
        environment: the kernels.
        length_scale: $\ell$ [L], more than $\sqrt 2\, b$.
    """
    centers, width = np.asarray(environment.centers), float(environment.width)
    squares = ((centers[:, None] - centers[None]) ** 2).sum(axis=-1)
    covariance = np.exp(-0.5 * squares / (length_scale**2 - 2 * width**2))
    covariance += JITTER * np.eye(len(centers))
    copies = np.ndim(environment.weights) == 2 and environment.weights.shape[1]
    return np.kron(covariance, np.eye(copies)) if copies else covariance
