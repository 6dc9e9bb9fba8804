"""Hills at the summits of a potential, and the geometry of single hills."""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import on_device
from pinav.fitting.structure.potential_map import SUMMIT, PotentialMap
from pinav.forces import KernelPotential

Hills = Float[np.ndarray, "hill 6"]
"""Height [L² T⁻²], centre [L] and shape, as in `HillsTerm`, of each hill."""

NUMBERS = 6

POINTS, REACH = 161, 1.5
"""Points along each side of the map of a potential, and distance from the data, in
widths of its kernels, up to which it counts."""

INSIDE = 1.2
"""Distance from a higher summit, in its own sizes, within which one is a part of it."""

SIZES = (0.4, 4.0)
"""Smallest and largest size at which a hill begins, in widths of the kernels."""

HALF = 0.6
"""Length of each of two hills that take the place of one, relative to it."""


def summits(
    potential: KernelPotential,
    positions: Float[np.ndarray, "point 2"],
    least: float | None = None,
) -> Hills:
    """Hills and wells as curved as a potential at its summits, the highest first.

    Args:
        least: height that counts [L² T⁻²]; a share of the highest unless given.
    """
    seen = PotentialMap.of_potential(potential, positions, POINTS, REACH)
    width = float(potential.width)
    middle = float(np.median(seen.heights[seen.is_seen]))
    heights = np.abs(seen.heights - middle)
    highest = max(float(heights[seen.is_seen].max()), np.finfo(float).tiny)
    places = seen.peaks(heights, SUMMIT if least is None else least / highest)
    hills: list[Float[np.ndarray, 6]] = []
    for place in places:
        height = float(potential.potential(0.0, on_device(place))) - middle
        bend = -np.asarray(_bend(potential, on_device(place))) / height
        values, vectors = np.linalg.eigh(bend)
        lowest, largest = (1 / (size * width) ** 2 for size in reversed(SIZES))
        hill = _hill(height, place, np.clip(values, lowest, largest), vectors)
        if all(_distance(other, place) > INSIDE for other in hills):
            hills.append(hill)
    return np.array(hills).reshape(-1, NUMBERS)


@eqx.filter_jit
def _bend(potential: KernelPotential, x: Float[Array, "2"]) -> Float[Array, "2 2"]:
    return jax.hessian(lambda place: potential.potential(0.0, place))(x)


def _hill(
    height: float,
    place: Float[np.ndarray, "2"],
    values: Float[np.ndarray, "2"],
    vectors: Float[np.ndarray, "2 2"],
) -> Float[np.ndarray, "6"]:
    """The hill whose metric has these eigenvalues [L⁻²] and eigenvectors."""
    logarithms = 0.5 * np.log(values)
    size = -np.mean(logarithms)
    shear = (vectors * (logarithms + size)) @ vectors.T
    return np.array([height, *place, size, shear[0, 0], shear[0, 1]])


def _axes(
    hill: Float[np.ndarray, "6"],
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2 2"]]:
    """Semi-axes of a hill, the longer first [L], and their directions as columns."""
    p, q = hill[4:]
    # e^{S - s} shrinks most along the eigenvector of the larger eigenvalue of S
    values, vectors = np.linalg.eigh(np.array([[p, q], [q, -p]]))
    return np.exp(hill[3] - values), vectors


def _distance(hill: Float[np.ndarray, "6"], place: Float[np.ndarray, "2"]) -> float:
    lengths, directions = _axes(hill)
    return float(np.linalg.norm(directions.T @ (place - hill[1:3]) / lengths))


def doubtful(hills: Hills) -> list[int]:
    """Hills that may be needless: those within another, and the smallest."""
    if len(hills) == 1:
        return []
    volumes = np.abs(hills[:, 0]) * np.exp(2 * hills[:, 3])
    smallest = int(np.argmin(volumes))
    within = [
        index
        for index, hill in enumerate(hills)
        if any(_distance(one, hill[1:3]) < INSIDE for one in np.delete(hills, index, 0))
    ]
    return list(dict.fromkeys([*within, smallest]))


def halves(hill: Float[np.ndarray, "6"]) -> Hills:
    """Two hills in a row in place of a long one."""
    lengths, directions = _axes(hill)
    away = 0.6 * lengths[0] * directions[:, 0]
    halved = lengths * np.array([HALF, 1.0])
    return np.array(
        [
            _hill(hill[0], hill[1:3] + sign * away, halved**-2, directions)
            for sign in (1.0, -1.0)
        ]
    )
