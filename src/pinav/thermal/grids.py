r"""Grids of cells: slab, cylinder and sphere along a radius, boxes of 1 to 3 axes.

Finite volumes: cell $i$ of a radial grid holds
$V_i = \omega_g (r_+^{g+1} - r_-^{g+1})/(g+1)$ between faces of area $\omega_g r^g$,
with $\omega_g = 1, 2\pi, 4\pi$ for $g = 0, 1, 2$: watts per square metre of a slab, per
metre of a cylinder, of the whole sphere.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.quantities import Field, Number, Numbers

SOLID_ANGLES = (1.0, 2 * np.pi, 4 * np.pi)
"""Area of the unit slab, cylinder and sphere."""

SUBCELLS = 8
"""Samples along each axis of a cell that a surface cuts."""


class AbstractGrid(eqx.Module):
    """Cells with volumes, faces and centres [m]."""

    @property
    @abc.abstractmethod
    def shape(self) -> tuple[int, ...]:
        """Number of cells along each axis."""

    @property
    @abc.abstractmethod
    def volumes(self) -> Field:
        """Volume of each cell [m³]."""

    @abc.abstractmethod
    def faces(self, axis: int) -> Field:
        """Area [m²] of the faces across an axis, one more than cells along it."""

    @abc.abstractmethod
    def half_widths(self, axis: int) -> Field:
        """Distance [m] from the centre of each cell to its faces across an axis."""

    @abc.abstractmethod
    def ball(self, radius: Scalar, *, center: Numbers | None = None) -> Field:
        """Share of each cell that lies in a ball about `center`; see `sphere`."""

    @abc.abstractmethod
    def distances(self, center: Numbers | None = None) -> Field:
        """Distance [m] of each cell's centre from a point, or from the middle."""

    @abc.abstractmethod
    def interpolation(self, points: Numbers) -> Float[Array, "point ..."]:
        """Weights of the cells in the value at each point; each point's sum to one.

        Raises:
            InputError: a point is outside the grid.
        """


class RadialGrid(AbstractGrid):
    r"""Cells along a coordinate $r$ in a slab, a cylinder or a sphere.

    Make one by `slab`, `cylinder` or `sphere`.

    Attributes:
        edges: faces of the cells [m], from 0.
        exponent: $g$, of the area $r^g$: 0, 1 or 2.

    Raises:
        InputError: there are fewer than three cells, or the edges do not increase
            from zero.
    """

    edges: Float[Array, " face"]
    exponent: int = eqx.field(static=True)

    @classmethod
    def slab(cls, length: Scalar, num_cells: int) -> "RadialGrid":
        """Equal cells of a slab from 0 to `length` [m]."""
        return cls(_equal("slab length", length, num_cells), 0)

    @classmethod
    def cylinder(cls, radius: Scalar, num_cells: int) -> "RadialGrid":
        """Equal cells along the radius [m] of a cylinder."""
        return cls(_equal("cylinder radius", radius, num_cells), 1)

    @classmethod
    def sphere(cls, radius: Scalar, num_cells: int) -> "RadialGrid":
        """Equal cells along the radius [m] of a sphere."""
        return cls(_equal("sphere radius", radius, num_cells), 2)

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.edges.shape[0] - 1,)

    @property
    def centers(self) -> Float[Array, " cell"]:
        """Middles of the cells [m]."""
        return 0.5 * (self.edges[1:] + self.edges[:-1])

    @property
    def volumes(self) -> Field:
        power = self.edges ** (self.exponent + 1) / (self.exponent + 1)
        return SOLID_ANGLES[self.exponent] * jnp.diff(power)

    def faces(self, axis: int) -> Field:
        return SOLID_ANGLES[self.exponent] * self.edges**self.exponent

    def half_widths(self, axis: int) -> Field:
        return 0.5 * jnp.diff(self.edges)

    def ball(self, radius: Scalar, *, center: Numbers | None = None) -> Field:
        _check_center(center)
        power = self.exponent + 1
        inside = jnp.clip(radius, self.edges[:-1], self.edges[1:])
        low, high = self.edges[:-1] ** power, self.edges[1:] ** power
        return (inside**power - low) / (high - low)

    def distances(self, center: Numbers | None = None) -> Field:
        _check_center(center)
        return self.centers

    def interpolation(self, points: Numbers) -> Float[Array, "point ..."]:
        r"""Linear between centres; at 0 $T_0 + (T_0 - T_1)/8$, as symmetry asks."""
        places = np.asarray(points, float).reshape(-1)
        edges = np.asarray(self.edges)
        outside = (places < 0) | (places > edges[-1])
        if outside.any():
            raise InputError(
                f"probe at {places[outside][0]:g} m: expected between 0 and "
                f"{edges[-1]:g} m, the end of the grid; move the probe"
            )
        centers = 0.5 * (edges[1:] + edges[:-1])
        weights = np.stack([_linear(place, centers) for place in places])
        if self.exponent:
            near = places < centers[0]
            weights[near] = 0.0
            # even in r: T = T0 + (T1 - T0) (r² - r0²)/(r1² - r0²)
            share = (places[near] ** 2 - centers[0] ** 2) / (
                centers[1] ** 2 - centers[0] ** 2
            )
            weights[near, 0], weights[near, 1] = 1 - share, share
        return jnp.asarray(weights)


class CartesianGrid(AbstractGrid):
    """Equal cells of a box, from the origin, along one, two or three axes.

    Attributes:
        cells: number of cells along each axis.
        spacing: size of a cell along each axis [m].

    Raises:
        InputError: the axes are not one to three, or a number is not positive.
    """

    cells: tuple[int, ...] = eqx.field(static=True)
    spacing: tuple[Scalar, ...]

    @classmethod
    def cubes(cls, cells: tuple[int, ...], size: Scalar) -> "CartesianGrid":
        """Cells as long along every axis [m]."""
        return cls(cells, (size,) * len(cells))

    def __check_init__(self) -> None:
        if not 1 <= len(self.cells) <= 3 or len(self.cells) != len(self.spacing):
            raise InputError(
                "CartesianGrid: expected one to three axes with a spacing each, got "
                f"{len(self.cells)} and {len(self.spacing)}"
            )
        for count, size in zip(self.cells, self.spacing, strict=True):
            if count < 3 or (isinstance(size, float | int) and not size > 0):
                raise InputError(
                    "CartesianGrid: expected 3 cells or more of positive size along "
                    f"each axis, got {count} of {size} m"
                )

    @property
    def shape(self) -> tuple[int, ...]:
        return self.cells

    @property
    def lengths(self) -> Float[Array, " axis"]:
        """Extent along each axis [m]."""
        pairs = zip(self.cells, self.spacing, strict=True)
        return jnp.stack([count * jnp.asarray(size, float) for count, size in pairs])

    @property
    def volumes(self) -> Field:
        return jnp.full(self.cells, self._volume)

    @property
    def _volume(self) -> Array:
        volume = jnp.asarray(1.0)
        for size in self.spacing:
            volume = volume * size
        return volume

    def faces(self, axis: int) -> Field:
        count = tuple(n + (i == axis) for i, n in enumerate(self.cells))
        return jnp.full(count, self._volume / self.spacing[axis])

    def half_widths(self, axis: int) -> Field:
        return jnp.full(self.cells, 0.5 * jnp.asarray(self.spacing[axis]))

    def ball(self, radius: Scalar, *, center: Numbers | None = None) -> Field:
        r"""From $8^d$ points of each cell, each a ramp of its own width.

        A step at each point would have no derivative by the radius.
        """
        return _ball_shares(self, radius, self._center(center))

    def distances(self, center: Numbers | None = None) -> Field:
        return self._distances(self._center(center))

    def _center(self, center: Numbers | None) -> Array:
        return 0.5 * self.lengths if center is None else jnp.asarray(center, float)

    def _distances(self, center: Array) -> Array:
        squares = jnp.zeros(self.cells)
        for axis, size in enumerate(self.spacing):
            offset = (jnp.arange(float(self.cells[axis])) + 0.5) * size - center[axis]
            shape = [1] * len(self.cells)
            shape[axis] = self.cells[axis]
            squares = squares + jnp.broadcast_to((offset**2).reshape(shape), self.cells)
        return jnp.sqrt(squares)

    def interpolation(self, points: Numbers) -> Float[Array, "point ..."]:
        """Linear along each axis; constant in the outer half of the outer cells."""
        places = np.asarray(points, float).reshape(-1, len(self.cells))
        lengths = np.asarray(self.lengths)
        outside = ((places < 0) | (places > lengths)).any(axis=1)
        if outside.any():
            raise InputError(
                f"probe at {places[outside][0].tolist()} m: expected inside the grid "
                f"of {lengths.tolist()} m; move the probe"
            )
        weights = np.ones((len(places), *self.cells))
        for axis, size in enumerate(self.spacing):
            centers = (np.arange(self.cells[axis]) + 0.5) * float(size)
            rows = [
                _linear(np.clip(p, centers[0], centers[-1]), centers)
                for p in places[:, axis]
            ]
            shape = [len(places)] + [1] * len(self.cells)
            shape[axis + 1] = self.cells[axis]
            weights = weights * np.stack(rows).reshape(shape)
        return jnp.asarray(weights)


@eqx.filter_jit
def _ball_shares(grid: "CartesianGrid", radius: Scalar, middle: Array) -> Array:
    axes = len(grid.cells)
    offsets = (np.arange(SUBCELLS) + 0.5) / SUBCELLS - 0.5
    shifts = np.stack(np.meshgrid(*[offsets] * axes, indexing="ij"), -1)
    sizes = jnp.stack([jnp.asarray(h, float) for h in grid.spacing])
    # each point counts as a ramp of this width: a step has no derivative
    width = jnp.max(sizes) / SUBCELLS

    def add(total: Array, shift: Array) -> tuple[Array, None]:
        distance = grid.distances(middle - shift * sizes)
        return total + jnp.clip(0.5 + (radius - distance) / width, 0.0, 1.0), None

    samples = jnp.asarray(shifts.reshape(-1, axes))
    total, _ = jax.lax.scan(add, jnp.zeros(grid.cells), samples)
    return total / SUBCELLS**axes


def _linear(place: Number, centers: np.ndarray) -> np.ndarray:
    """Weights of linear interpolation, continued beyond the first and last centre."""
    index = int(np.clip(np.searchsorted(centers, place) - 1, 0, len(centers) - 2))
    share = (place - centers[index]) / (centers[index + 1] - centers[index])
    weights = np.zeros(len(centers))
    weights[index], weights[index + 1] = 1 - share, share
    return weights


def _equal(name: str, length: Scalar, num_cells: int) -> Array:
    if num_cells < 3:
        raise InputError(f"{name}: expected 3 cells or more, got {num_cells}")
    if isinstance(length, float | int) and not 0 < length < np.inf:
        raise InputError(f"{name}: expected a length > 0 m, got {length}")
    return jnp.asarray(length, float) * jnp.linspace(0.0, 1.0, num_cells + 1)


def _check_center(center: Numbers | None) -> None:
    if center is not None:
        raise InputError(
            "RadialGrid: a ball is centred at 0; use a CartesianGrid for another center"
        )


def scale_to(field: Field, grid: AbstractGrid, total: Scalar) -> Field:
    """The field times a factor that makes its integral `total`.

    A volume-fraction mask times a concentration misses the injected mass by the error
    of its volume; this restores it.

    Args:
        field: a density.
        grid: of its cells.
        total: its integral over the grid, such as the injected mass [kg].
    """
    return field * (total / jnp.sum(field * grid.volumes))
