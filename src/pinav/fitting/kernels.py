"""Kernel environments made from data, and the Gaussian-process prior of their weights.

A grid of radial basis functions of width b, whose weights have a squared-exponential
covariance, is a Gaussian process: the basis filters the weights.
"""

from typing import TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.errors import InputError
from pinav.learned import KernelForce, KernelPotential, kernel_centers
from pinav.trajectories import Trajectories

Kernel = TypeVar("Kernel", KernelForce, KernelPotential)


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

    def __check_init__(self):
        for name in ("across", "width", "margin"):
            if not getattr(self, name) > 0:
                raise InputError(
                    f"KernelGrid.{name}: expected > 0, got {getattr(self, name)}"
                )


WITHOUT_PRIOR = KernelGrid(across=10, width=1.5, margin=2.0)
"""Wide kernels close to the data: where no prior makes the field smooth."""


def kernel_environment(
    kind: type[Kernel], trajectories: Trajectories, grid: KernelGrid | None = None
) -> Kernel:
    """An untrained kernel environment on a grid around the data: no force at all.

    Unless given, the grid is as fine as a twelfth of the longer side of the data, the
    kernels are as wide as the grid is fine, and they reach four intervals beyond the
    samples: a prior must not end within its own length scale.

    Args:
        kind: `KernelForce` or `KernelPotential`.
        trajectories: their channels are positions, then as many velocities.
        grid: its fineness; `KernelGrid()` unless given.

    Raises:
        InputError: the observed positions are fewer than two, or all the same.
    """
    grid = KernelGrid() if grid is None else grid
    dim = len(trajectories.channels) // 2
    seen = trajectories.observed[..., :dim].all(axis=-1)
    positions = trajectories.states[..., :dim][seen]
    extent = float(np.ptp(positions, axis=0).max()) if len(positions) > 1 else 0.0
    if not extent > 0:
        raise InputError(
            "kernel_environment: expected two or more different observed positions"
        )
    spacing = extent / grid.across
    centers = kernel_centers(positions, spacing=spacing, margin=grid.margin * spacing)
    shape = centers.shape if kind is KernelForce else centers.shape[:1]
    return kind(jnp.zeros(shape), jnp.asarray(centers), grid.width * spacing)


class WeightPrior(eqx.Module):
    r"""Gaussian-process prior of the weights of one environment, of unit amplitude.

    $K_{ij} = D_i D_j \exp(-|c_i - c_j|^2 / 2\ell^2)$ with the envelope
    $D_i = \exp(-|c_i - m|^2 / 2 R^2)$: a field of length scale $\ell$ that may fade
    away from a place. Where nothing fades the evidence makes R large, and the prior is
    stationary. The envelope is what separates an obstacle from a constant force: a
    stationary prior takes a slope over the whole domain for an obstacle.

    Attributes:
        environment: the kernels.
    """

    environment: KernelForce | KernelPotential

    @property
    def start(self) -> Float[np.ndarray, " shape"]:
        """Shape of a wide envelope about the middle of the kernels."""
        return np.append([0.5, np.log(0.5 * self._extent)], np.zeros(self._dim))

    @property
    def bounds(self) -> Float[np.ndarray, "shape 2"]:
        """Between which the shape is sought."""
        extent = self._extent
        half = 0.5 * extent
        scales = [(-1.2, np.log(10 * extent)), (0.0, np.log(10 * extent))]
        return np.array(scales + [(-half, half)] * self._dim)

    def covariance(
        self, shape: Float[np.ndarray, " shape"]
    ) -> Float[np.ndarray, "weight weight"]:
        r"""Covariance of the weights, flattened as they are.

        Args:
            shape: $\log \ell$, $\log R$, and $m$ from the middle, all in widths.
        """
        centers = self._scaled_centers
        length_scale, reach = np.exp(shape[:2])
        squares = ((centers[:, None] - centers[None]) ** 2).sum(axis=-1)
        envelope = np.exp(-0.5 * ((centers - shape[2:]) ** 2).sum(axis=-1) / reach**2)
        covariance = np.exp(-0.5 * squares / length_scale**2)
        covariance *= np.outer(envelope, envelope)
        if isinstance(self.environment, KernelForce):
            return np.kron(covariance, np.eye(self._dim))
        return covariance

    @property
    def _scaled_centers(self):
        centers = np.asarray(self.environment.centers, float)
        middle = (centers.min(axis=0) + centers.max(axis=0)) / 2
        return (centers - middle) / float(self.environment.width)

    @property
    def _extent(self):
        return float(max(np.ptp(self._scaled_centers, axis=0).max(), 1.0))

    @property
    def _dim(self):
        return np.shape(self.environment.centers)[1]
