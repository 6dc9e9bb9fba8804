"""The potential that free kernels have in linearised data, and its summits."""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.ndimage import maximum_filter

from pinav.arguments import on_device
from pinav.errors import FitError
from pinav.fitting.environments.kernels import KernelGrid, surround_with_kernels
from pinav.fitting.evidence.evidence import (
    LinearisedObservations,
    Whitened,
    at_shape,
    posterior_mean,
)
from pinav.fitting.structure.response import ForceResponse, force_quadratic
from pinav.forces import KernelPotential

MAP, MAP_POINTS = KernelGrid(across=16, margin=2.0), 61
"""Kernels of the map whose summits are sought, and points along each side of it."""

MOST_SUMMITS, NEARBY, SUMMIT = 8, 9, 0.3
"""Summits at most, points of the map within which one is the only one, and its height
at least, relative to the highest."""


class PotentialMap(eqx.Module):
    """The potential [L² T⁻²] that free kernels have in the linearised data."""

    places: Float[np.ndarray, "row column 2"]
    heights: Float[np.ndarray, "row column"]
    is_seen: Bool[np.ndarray, "row column"]

    @classmethod
    def of(cls, response: ForceResponse) -> "PotentialMap | None":
        """The map of the data; None where they do not depend on it."""
        positions = np.asarray(response.points).reshape(-1, 2)
        potential = free_potential(response, positions)
        return None if potential is None else cls.of_potential(potential, positions)

    @classmethod
    def of_potential(
        cls,
        potential: KernelPotential,
        positions: Float[np.ndarray, "point 2"],
        points: int = MAP_POINTS,
        reach: float = 1.0,
    ) -> "PotentialMap":
        """The map of a potential.

        Args:
            reach: distance from the data, in widths of the kernels, up to which the
                potential counts as seen.
        """
        from scipy.spatial import KDTree

        axes = np.linspace(positions.min(axis=0), positions.max(axis=0), points).T
        places = np.stack(np.meshgrid(*axes), axis=-1)
        heights = np.asarray(_heights(potential, on_device(places.reshape(-1, 2))))
        gaps = KDTree(positions).query(places)[0]
        return cls(
            places=places,
            heights=heights.reshape(places.shape[:2]),
            is_seen=gaps < reach * float(potential.width),
        )

    def peaks(
        self, heights: Float[np.ndarray, "row column"], least: float = SUMMIT
    ) -> Float[np.ndarray, "peak 2"]:
        """Places of peaks of heights over the map, the highest first [L].

        Args:
            least: height that counts, relative to the highest.
        """
        seen = np.where(self.is_seen, heights, 0.0)
        is_peak = (seen == maximum_filter(seen, size=NEARBY)) & (
            seen > least * seen.max()
        )
        order = np.argsort(-seen[is_peak])
        return self.places[is_peak][order]

    def summits(self) -> Float[np.ndarray, "place 2"]:
        """Places where the potential differs most from that of a linear force [L]."""
        x, y = np.moveaxis(self.places, -1, 0)
        columns = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
        seen = columns[self.is_seen], self.heights[self.is_seen]
        rest = self.heights - columns @ np.linalg.lstsq(*seen, rcond=None)[0]
        return self.peaks(np.abs(rest))[:MOST_SUMMITS]


@eqx.filter_jit
def _heights(
    potential: KernelPotential, places: Float[Array, "place 2"]
) -> Float[Array, " place"]:
    return jax.vmap(lambda x: potential.potential(0.0, x))(places)


def free_potential(
    response: ForceResponse, positions: Float[np.ndarray, "point 2"]
) -> KernelPotential | None:
    """Free kernels of the linearised data; None if the data do not depend on them."""
    kernels = KernelPotential.with_zero_weights(*surround_with_kernels(positions, MAP))
    prior = kernels.prior()
    shape = prior.start.copy()
    shape[1] = prior.bounds[1, 1]
    try:
        data = LinearisedObservations.of(force_quadratic([kernels], response))
    except FitError:
        return None
    chosen = at_shape(data, prior.covariance, shape)
    mean = posterior_mean(Whitened.of(data, prior.covariance(shape)), chosen)
    return KernelPotential(on_device(mean), kernels.centers, kernels.width)
