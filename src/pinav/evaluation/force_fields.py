r"""Force fields on a grid and along lines, and their agreement with the truth.

A place belongs to a region by its distance d to the nearest observed position of the
training data: visited, $d \le \ell_1$; near, $d \le \ell_2$, visited places included;
unvisited, $d > \ell_2$. The lengths $\ell_1 < \ell_2$ are those of `Regions`.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from pinav.arguments import on_device
from pinav.dynamics import Swimmer, with_dtype
from pinav.errors import InputError
from pinav.forces import AbstractForce, forces_at
from pinav.trajectories import Trajectories

VISITED, NEAR = 0.35, 1.0
"""Grid points this close to a sample [L] are called visited, and near, where lengths
are dimensionless."""

VISITED_FRACTION, NEAR_FRACTION = 1 / 40, 1 / 14
"""The same as fractions of the data's extent, where lengths have a unit. The shots of
`barrier-crossings` cover a square of side 14, so that the two rules agree on it."""

LEAST, MOST = 3.5, 56.0
"""Extents between which lengths without a unit are taken for dimensionless."""


class Regions(eqx.Module):
    r"""Distances from the data up to which places are called visited, and near.

    Attributes:
        visited: $\ell_1$ [L], positive.
        near: $\ell_2$ [L], larger.

    Raises:
        InputError: not 0 < `visited` < `near` < infinity.
    """

    visited: float = eqx.field(static=True, default=VISITED)
    near: float = eqx.field(static=True, default=NEAR)

    def __check_init__(self) -> None:
        if not 0 < self.visited < self.near < np.inf:
            raise InputError(
                "Regions: expected 0 < visited < near, got "
                f"{self.visited:g} and {self.near:g}"
            )

    def masks(
        self, distance: Float[np.ndarray, "*shape"]
    ) -> dict[str, Bool[np.ndarray, "*shape"]]:
        """Points of each region, by their distance to the data [L]."""
        return {
            "visited": distance <= self.visited,
            "near": distance <= self.near,
            "unvisited": distance > self.near,
        }

    def definition(self, unit: str = "1") -> str:
        """The definition in words, for tables; a unit of "1" means dimensionless."""
        suffix = "" if unit in ("1", "?", "") else f" {unit}"
        return (
            f"visited: within {self.visited:.3g}{suffix} of an observed position of "
            f"the training data; near: within {self.near:.3g}{suffix}, visited places "
            "included; unvisited: farther away"
        )


def default_regions(trajectories: Trajectories) -> Regions:
    """The lengths that suit the data: fixed if dimensionless, else by their extent.

    Args:
        trajectories: the training data. Where the unit of `x` is "1" and the largest
            side of the box around all observed positions is between `LEAST` and `MOST`
            the lengths are `VISITED` and `NEAR`; otherwise those fractions of it.

    Raises:
        InputError: all observed positions are the same.
    """
    length = extent(trajectories)
    is_bare = trajectories.units.get(trajectories.channels[0]) == "1"
    if is_bare and (length == 0 or LEAST < length < MOST):
        return Regions()
    if not length > 0:
        raise InputError(
            "regions: all observed positions are the same, so there is no extent; "
            "give the lengths, such as Regions(visited=2.0, near=5.0)"
        )
    return Regions(VISITED_FRACTION * length, NEAR_FRACTION * length)


def extent(trajectories: Trajectories) -> float:
    """Largest side of the box around all observed positions [L]."""
    samples = trajectories.seen_positions
    return float((samples.max(axis=0) - samples.min(axis=0)).max())


class FieldMap(eqx.Module):
    """A planar force on a grid, and the distance [L] of its points from the data."""

    x: Float[np.ndarray, " columns"]
    y: Float[np.ndarray, " rows"]
    force: Float[np.ndarray, "rows columns 2"]
    distance: Float[np.ndarray, "rows columns"]
    regions: Regions = Regions()

    @property
    def points(self) -> Float[np.ndarray, "point 2"]:
        """The points of the grid, row by row [L]."""
        return np.stack(np.meshgrid(self.x, self.y), axis=-1).reshape(-1, 2)

    def showing(self, force: Float[np.ndarray, "rows columns 2"]) -> "FieldMap":
        """Another force [L T⁻²] on the same grid."""
        return dataclasses.replace(self, force=force)


def field_map(
    force: AbstractForce,
    trajectories: Trajectories,
    *,
    limits: tuple[float, float, float, float] | None = None,
    points: int = 57,
) -> FieldMap:
    """The force of a swimmer at rest at each point of a planar grid.

    Where it depends on time each point takes that of its nearest sample, the reading
    most favourable to such a field.

    Args:
        limits: x from, x to, y from, y to [L]; a square around the data unless given.

    Raises:
        InputError: the data are not planar.
    """
    check_planar(trajectories)
    x_from, x_to, y_from, y_to = square(trajectories) if limits is None else limits
    x, y = np.linspace(x_from, x_to, points), np.linspace(y_from, y_to, points)
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    flat = grid.reshape(-1, 2)
    distance, ts = _nearest_samples(flat, trajectories)
    return FieldMap(
        x,
        y,
        exact_forces(force, flat, ts).reshape(grid.shape),
        distance.reshape(grid.shape[:2]),
        default_regions(trajectories),
    )


def check_planar(trajectories: Trajectories) -> None:
    """Refuse data that no map can show."""
    if trajectories.dim != 2:
        raise InputError(
            "force map: expected positions in the plane (x, y), got the channels "
            f"{', '.join(trajectories.channels)}; maps are drawn of planar data alone"
        )


def square(trajectories: Trajectories) -> tuple[float, float, float, float]:
    """The smallest square around the data and what is near them [L]: x0, x1, y0, y1."""
    (x_from, y_from), (x_to, y_to) = enclosing_cube(trajectories)
    return x_from, x_to, y_from, y_to


def enclosing_cube(
    trajectories: Trajectories,
) -> tuple[Float[np.ndarray, " dim"], Float[np.ndarray, " dim"]]:
    """Lower and upper corner of the same in any number of dimensions [L]."""
    samples = trajectories.seen_positions
    margin = default_regions(trajectories).near
    low, high = samples.min(axis=0), samples.max(axis=0)
    middle, half = (low + high) / 2, (high - low).max() / 2 + margin
    return middle - half, middle + half


def distances(
    points: Float[np.ndarray, "point dim"], trajectories: Trajectories
) -> Float[np.ndarray, " point"]:
    """Distance of each point to the nearest fully observed position [L]."""
    return _nearest_samples(points, trajectories)[0]


def _nearest_samples(
    points: Float[np.ndarray, "point dim"], trajectories: Trajectories
) -> tuple[Float[np.ndarray, " point"], Float[np.ndarray, " point"]]:
    from scipy.spatial import KDTree

    distance, index = KDTree(trajectories.seen_positions).query(points)
    return distance, trajectories.times[trajectories.seen][index]


class Agreement(eqx.Module):
    r"""Agreement of two fields on a set of grid points.

    Attributes:
        error: $\|F - F^*\|_2 / \|F^*\|_2$, all points and components together.
        cosine: $F \cdot F^* / (\|F\|_2 \|F^*\|_2)$; 1 for forces that are right but for
            a common factor. NaN where either field is zero.
        points: how many there are; where there is none, the others are NaN.
    """

    error: float
    cosine: float
    points: int


def agreement(
    learned: FieldMap, true: FieldMap, region: Bool[np.ndarray, "rows columns"]
) -> Agreement:
    """Relative error and cosine similarity over the grid points of a region."""
    a, b = learned.force[region], true.force[region]
    size, true_size = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    return Agreement(
        error=_ratio(float(np.linalg.norm(a - b)), true_size),
        cosine=_ratio(np.sum(a * b), size * true_size),
        points=len(a),
    )


def _ratio(numerator: float, denominator: float) -> float:
    return float(numerator / denominator) if denominator > 0 else float("nan")


def force_agreement(
    learned: FieldMap, true: FieldMap, regions: Regions | None = None
) -> dict[str, Agreement]:
    """Agreement in visited, near and unvisited regions and on the whole grid.

    Args:
        true: the truth on the same grid; its distances define the regions.
    """
    masks = (true.regions if regions is None else regions).masks(true.distance)
    masks["everywhere"] = np.ones_like(true.distance, bool)
    return {name: agreement(learned, true, mask) for name, mask in masks.items()}


def force_errors(
    learned: FieldMap, true: FieldMap, regions: Regions | None = None
) -> dict[str, float]:
    """Relative L2 force error in visited and near regions, and on the whole grid."""
    agreements = force_agreement(learned, true, regions)
    return {name: agreements[name].error for name in ("visited", "near", "everywhere")}


ENDS = (0.01, 0.99)
"""Shares of the data between which a line runs."""

MOST_SAMPLES = 2000
"""Samples at most at which two forces are compared."""


class ForceLine(eqx.Module):
    """The component of a force along a line, over the coordinate on it [L]."""

    places: Float[np.ndarray, " place"]
    force: Float[np.ndarray, " place"]
    sd: Float[np.ndarray, " place"] | None = None
    true: Float[np.ndarray, " place"] | None = None


def line_through(
    positions: Float[np.ndarray, "sample dim"], axis: int, points: int = 60
) -> Float[np.ndarray, "point dim"]:
    """Points along one axis through the middle of the data, without its tails."""
    line = np.tile(np.median(positions, axis=0), (points, 1))
    low, high = np.quantile(positions[:, axis], ENDS)
    line[:, axis] = np.linspace(low, high, points)
    return line


def force_line(
    force: AbstractForce,
    data: Trajectories,
    axis: int,
    *,
    posterior: Any = None,
    truth: AbstractForce | None = None,
) -> ForceLine:
    """A force along one axis through the middle of the data, at time zero."""
    points = line_through(data.seen_positions, axis)
    return ForceLine(
        points[:, axis],
        exact_forces(force, points)[:, axis],
        None if posterior is None else posterior.force_sd(points)[:, axis],
        None if truth is None else exact_forces(truth, points)[:, axis],
    )


def force_error_at_samples(
    force: AbstractForce, truth: AbstractForce, data: Trajectories
) -> float:
    """Relative L2 error of a force at observed positions; those of many are thinned."""
    positions = data.seen_positions
    positions = positions[:: max(len(positions) // MOST_SAMPLES, 1)]
    learned, true = exact_forces(force, positions), exact_forces(truth, positions)
    size = float(np.linalg.norm(true))
    return float(np.linalg.norm(learned - true)) / size if size > 0 else float("nan")


def exact_forces(
    force: AbstractForce,
    points: Float[np.ndarray, "point dim"],
    times: Float[np.ndarray, " point"] | None = None,
) -> Float[np.ndarray, "point dim"]:
    """The force on a swimmer at rest at each point in float64, by default at time 0."""
    times = np.zeros(len(points)) if times is None else times
    with jax.enable_x64(new_val=True):
        return np.asarray(forces_at(with_dtype(force, jnp.float64), times, points))


class Decomposition(eqx.Module):
    """Propulsion, environment and drag along a trajectory, as accelerations [L T⁻²]."""

    times: Float[np.ndarray, " time"]
    terms: dict[str, Float[np.ndarray, "time dim"]]


def decompose(
    swimmer: Swimmer,
    times: Float[np.ndarray, " time"],
    states: Float[np.ndarray, "time state"],
) -> Decomposition:
    """Split a(t) = propulsion + environment + drag along given states.

    References:
        PI-NAV paper, addendum 3 (structural interpretability).
    """
    exact = with_dtype(swimmer, jnp.float64)
    terms = _terms(exact, on_device(times), on_device(states))
    return Decomposition(np.asarray(times), jax.tree.map(np.asarray, terms))


@eqx.filter_jit
def _terms(
    swimmer: Swimmer,
    times: Float[Array, " time"],
    states: Float[Array, "time state"],
) -> dict[str, Float[Array, "time dim"]]:
    """One compiled program in place of one for each operation."""
    x, v = jnp.split(states, 2, axis=1)
    forces = {
        "propulsion": swimmer.propulsion,
        "environment": swimmer.environment,
        "drag": swimmer.drag,
    }
    return {name: jax.vmap(force)(times, x, v) for name, force in forces.items()}
