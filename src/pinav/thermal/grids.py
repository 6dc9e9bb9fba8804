r"""Grids of cells: slab, cylinder and sphere along a radius, boxes of 1 to 3 axes.

Finite volumes: cell $i$ of a radial grid holds
$V_i = \omega_g (r_+^{g+1} - r_-^{g+1})/(g+1)$ between faces of area $\omega_g r^g$,
with $\omega_g = 1, 2\pi, 4\pi$ for $g = 0, 1, 2$: watts per square metre of a slab, per
metre of a cylinder, of the whole sphere.
"""

import abc
import functools

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

    @property
    @abc.abstractmethod
    def cell_sizes(self) -> tuple[float, ...]:
        """Edges of the first cell [m]; those of all cells of a box."""

    @property
    @abc.abstractmethod
    def extent(self) -> tuple[float, ...]:
        """Length along each axis [m]."""

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
    def interpolation(
        self, points: Numbers, conductivity: Numbers | Number = 1.0
    ) -> Float[Array, "point ..."]:
        """Weights of the cells in the value at each point; each point's sum to one.

        Linear in the thermal resistance along each axis, so that the flux, not the
        slope, is continuous where the conductivity jumps.

        Args:
            points: [m].
            conductivity: of each cell, in any unit; the same everywhere unless given.

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
    def cell_sizes(self) -> tuple[float, ...]:
        return (float(self.edges[1] - self.edges[0]),)

    @property
    def extent(self) -> tuple[float, ...]:
        return (float(self.edges[-1]),)

    @property
    def centers(self) -> Float[Array, " cell"]:
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
        return _radial_ball(self.exponent, self.edges, jnp.asarray(radius, float))

    def distances(self, center: Numbers | None = None) -> Field:
        _check_center(center)
        return self.centers

    def interpolation(
        self, points: Numbers, conductivity: Numbers | Number = 1.0
    ) -> Float[Array, "point ..."]:
        r"""At 0 $T_0 + (T_0 - T_1)/8$, as symmetry asks."""
        places = np.asarray(points, float).reshape(-1)
        edges = np.asarray(self.edges)
        outside = (places < 0) | (places > edges[-1])
        if outside.any():
            raise InputError(
                f"probe at {places[outside][0]:g} m: expected between 0 and "
                f"{edges[-1]:g} m, the end of the grid; move the probe"
            )
        centers = 0.5 * (edges[1:] + edges[:-1])
        along = ResistanceScale.of(edges, np.broadcast_to(conductivity, self.shape))
        weights = np.stack([linear_weights(along.at(x), along.values) for x in places])
        if self.exponent:
            near = places < centers[0]
            weights[near] = 0.0
            # even in r: T = T0 + (T1 - T0) (r² - r0²)/(r1² - r0²)
            fraction = (places[near] ** 2 - centers[0] ** 2) / (
                centers[1] ** 2 - centers[0] ** 2
            )
            weights[near, 0], weights[near, 1] = 1 - fraction, fraction
        return jnp.asarray(weights)


class CartesianGrid(AbstractGrid):
    """Equal cells of a box, from the origin, along one, two or three axes.

    Attributes:
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
    def cell_sizes(self) -> tuple[float, ...]:
        return tuple(float(size) for size in self.spacing)

    @property
    def extent(self) -> tuple[float, ...]:
        return tuple(self.lengths.tolist())

    @property
    def lengths(self) -> Float[Array, " axis"]:
        pairs = zip(self.cells, self.spacing, strict=True)
        return jnp.stack([count * jnp.asarray(size, float) for count, size in pairs])

    @property
    def volumes(self) -> Field:
        return jnp.full(self.cells, self._volume)

    @property
    def _volume(self) -> Array:
        return functools.reduce(jnp.multiply, self.spacing, jnp.asarray(1.0))

    def _center(self, center: Numbers | None) -> Array:
        return 0.5 * self.lengths if center is None else jnp.asarray(center, float)

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
        middle = self._center(center)
        squares = jnp.zeros(self.cells)
        for axis, size in enumerate(self.spacing):
            offset = (jnp.arange(float(self.cells[axis])) + 0.5) * size - middle[axis]
            shape = [1] * len(self.cells)
            shape[axis] = self.cells[axis]
            squares = squares + jnp.broadcast_to((offset**2).reshape(shape), self.cells)
        return jnp.sqrt(squares)

    def interpolation(
        self, points: Numbers, conductivity: Numbers | Number = 1.0
    ) -> Float[Array, "point ..."]:
        """Constant in the outer half of the outer cells.

        The resistance is that of the line of cells through the point, so that faces
        between tissues are exact where they are normal to an axis.
        """
        places = np.asarray(points, float).reshape(-1, len(self.cells))
        lengths = np.asarray(self.lengths)
        outside = ((places < 0) | (places > lengths)).any(axis=1)
        if outside.any():
            raise InputError(
                f"probe at {places[outside][0].tolist()} m: expected inside the grid "
                f"of {lengths.tolist()} m; move the probe"
            )
        k = np.broadcast_to(np.asarray(conductivity, float), self.cells)
        rows = [self._line_weights(place, k) for place in places]
        return jnp.asarray(np.stack(rows))

    def _line_weights(self, place: np.ndarray, k: np.ndarray) -> np.ndarray:
        """Weights of all cells at one point, a product of those along each axis."""
        sizes = [float(size) for size in self.spacing]
        cell = [
            min(int(x / h), n - 1)
            for x, h, n in zip(place, sizes, self.cells, strict=True)
        ]
        weights = np.ones(())
        for axis, (h, n) in enumerate(zip(sizes, self.cells, strict=True)):
            line = k[tuple(slice(None) if a == axis else c for a, c in enumerate(cell))]
            along = ResistanceScale.of(h * np.arange(n + 1), line)
            low, high = along.values[[0, -1]]
            at = np.clip(along.at(place[axis]), low, high)
            weights = weights[..., None] * linear_weights(at, along.values)
        return weights


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


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _radial_ball(exponent: int, edges: Array, radius: Array) -> Array:
    """Share of each cell within a radius."""
    return _shares_within(exponent, edges, radius)


def _shares_within(exponent: int, edges: Array, radius: Array) -> Array:
    power = exponent + 1
    inside = jnp.clip(radius, edges[:-1], edges[1:])
    low, high = edges[:-1] ** power, edges[1:] ** power
    return (inside**power - low) / (high - low)


@_radial_ball.defjvp
def _radial_ball_jvp(
    exponent: int, primals: tuple[Array, Array], tangents: tuple[Array, Array]
) -> tuple[Array, Array]:
    """The shell added at the radius, shared linearly by the two cells beside it.

    The cut cell alone would get all of it wherever in the cell the radius is, an error
    of half a cell; at a face, rounding would say which cell.
    """
    edges, radius = primals
    value, by_edges = jax.jvp(
        lambda e: _shares_within(exponent, e, radius), (edges,), (tangents[0],)
    )
    centers = 0.5 * (edges[1:] + edges[:-1])
    place = jnp.clip(radius, centers[0], centers[-1])
    gaps = jnp.diff(centers)
    into = jnp.clip((place - centers[:-1]) / gaps, 0.0, 1.0)
    weights = jnp.concatenate([jnp.ones(1), into]) - jnp.append(into, 0.0)
    power = exponent + 1
    volumes = jnp.diff(edges**power) / power
    within = (radius > 0) & (radius <= edges[-1])
    shell = jnp.where(within, radius**exponent * weights / volumes, 0.0)
    return value, by_edges + shell * tangents[1]


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


class ResistanceScale(eqx.Module):
    r"""Thermal resistance along a line of cells.

    Along $x$ the flux $-k\,\partial T/\partial x$ is continuous where $k$ jumps, so
    that temperature is linear in $\rho = \int dx/k$ across the jump, not in $x$. A
    cell's temperature is that of the middle of its resistance. A cell whose
    conductivity lies between those of its neighbours is cut: with $1/k$ averaged by
    volume, the share of each neighbour's material says where the jump is.

    Attributes:
        places: faces and jumps of the conductivity within cells [m].
        resistances: up to these places [m² K W⁻¹].
        values: up to the middle of each cell's resistance.
    """

    places: Float[np.ndarray, " place"]
    resistances: Float[np.ndarray, " place"]
    values: Float[np.ndarray, " cell"]

    @classmethod
    def of(
        cls, edges: Float[np.ndarray, " face"], conductivity: Float[np.ndarray, " cell"]
    ) -> "ResistanceScale":
        resistivity, sizes = 1 / np.asarray(conductivity, float), np.diff(edges)
        faces = np.append(0.0, np.cumsum(resistivity * sizes))
        before, after = resistivity[:-2], resistivity[2:]
        change = np.where(before == after, 1.0, before - after)
        fraction = (resistivity[1:-1] - after) / change
        cut = (before != after) & (fraction > 0) & (fraction < 1)
        jumps = edges[1:-2] + fraction * sizes[1:-1]
        at_jumps = faces[1:-2] + fraction * sizes[1:-1] * before
        places = np.append(edges, jumps[cut])
        order = np.argsort(places)
        return cls(
            places=places[order],
            resistances=np.append(faces, at_jumps[cut])[order],
            values=0.5 * (faces[1:] + faces[:-1]),
        )

    def at(self, place: Number) -> float:
        """Resistance up to a place [m]."""
        return float(np.interp(place, self.places, self.resistances))


def linear_weights(
    at: Number, nodes: Float[np.ndarray, " node"]
) -> Float[np.ndarray, " node"]:
    """Weights of linear interpolation, continued beyond the first and last node."""
    index = int(np.clip(np.searchsorted(nodes, at) - 1, 0, len(nodes) - 2))
    fraction = (at - nodes[index]) / (nodes[index + 1] - nodes[index])
    weights = np.zeros(len(nodes))
    weights[index], weights[index + 1] = 1 - fraction, fraction
    return weights
