r"""Sources of heat: a shape in space times a level that the field sets."""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.grids import AbstractGrid, CartesianGrid, RadialGrid
from pinav.thermal.magnetics import VACUUM_PERMEABILITY, AbstractHeating
from pinav.thermal.quantities import Field, Length, Numbers, Place, Siemens
from pinav.thermal.tissues import Property


class AbstractSource(eqx.Module):
    """Power per volume, `shape * level` [W m⁻³]."""

    @abc.abstractmethod
    def shape(self, grid: AbstractGrid) -> Field:
        """The part that depends on the cell."""

    @abc.abstractmethod
    def level(self, amplitude: Scalar, frequency: Scalar) -> Float[Array, ""]:
        """The part that depends on the field: peak [A m⁻¹] and frequency [Hz]."""


class ParticleSource(AbstractSource):
    r"""Nanoparticles, $Q = s\,\rho_{mnp}\,\mathrm{SLP}(H, f)$.

    Attributes:
        concentration: $\rho_{mnp}$ in each cell [kg m⁻³], of the mass that the SLP is
            per.
        scale: $s$; in vivo the SLP is often far below that of a suspension. At steady
            state it cannot be told from perfusion: learn it from steps of the power.
    """

    concentration: Field
    heating: AbstractHeating
    scale: Scalar = 1.0

    def shape(self, grid: AbstractGrid) -> Field:
        return self.concentration

    def level(self, amplitude: Scalar, frequency: Scalar) -> Float[Array, ""]:
        return self.scale * self.heating.slp(amplitude, frequency)


class PowerSource(AbstractSource):
    r"""A given power density, that goes with the square of the field, $Q (H/H_0)^2$.

    Attributes:
        power: $Q$ in each cell [W m⁻³], at the amplitude $H_0$.
        reference: $H_0$ [A m⁻¹].
    """

    power: Field
    reference: Scalar
    scale: Scalar = 1.0

    def shape(self, grid: AbstractGrid) -> Field:
        return self.power

    def level(self, amplitude: Scalar, frequency: Scalar) -> Float[Array, ""]:
        return jnp.asarray(self.scale * (amplitude / self.reference) ** 2)


class ShiftedSource(AbstractSource):
    """Another source, moved as a whole: to learn where a map of power is.

    Between cells by Keys' convolution of fourth order, which keeps the total of what
    stays within the grid and has a derivative everywhere. What comes in over a side
    falls off as the map does there, by a constant ratio from cell to cell; where the
    map does not fall off, it is as there.

    Attributes:
        source: on a box.
        shift: along each axis [m].
        density: a factor that stays where it is: that of the tissue [kg m⁻³] where the
            source is one of SAR.
    """

    source: AbstractSource
    shift: Float[Array, " axis"]
    density: Property = 1.0

    def shape(self, grid: AbstractGrid) -> Field:
        assert isinstance(grid, CartesianGrid)
        moved = self.source.shape(grid)
        for axis, (count, size) in enumerate(
            zip(grid.cells, grid.spacing, strict=True)
        ):
            weights = _shift_weights(count, self.shift[axis] / size)
            lines = _continue_lines(jnp.moveaxis(moved, axis, 0))
            moved = jnp.moveaxis(jnp.tensordot(weights, lines, axes=(1, 0)), 0, axis)
        return self.density * moved

    def level(self, amplitude: Scalar, frequency: Scalar) -> Float[Array, ""]:
        return self.source.level(amplitude, frequency)


BEYOND = 8
"""Cells by which a map is continued over each side; then it is as at the last."""


def _continue_lines(lines: Array) -> Array:
    """Continued along the first axis, falling off as over the last two cells."""
    steps = jnp.arange(1.0, BEYOND + 1).reshape(-1, *(1 for _ in lines.shape[1:]))

    def beyond(last: Array, before: Array) -> Array:
        falls = (before > 0) & (last > 0) & (last < before)
        ratio = jnp.where(falls, last / jnp.where(falls, before, 1.0), 1.0)
        return last[None] * ratio[None] ** steps

    low, high = beyond(lines[0], lines[1])[::-1], beyond(lines[-1], lines[-2])
    return jnp.concatenate([low, lines, high])


def _shift_weights(count: int, cells: Array) -> Float[Array, "to from"]:
    """Of a continued line that moves by a number of cells (Keys 1981, six points)."""
    places = jnp.clip(
        jnp.arange(float(count)) - cells, 2.0 - BEYOND, count - 3.0 + BEYOND
    )
    nodes = jnp.arange(-float(BEYOND), float(count + BEYOND))
    x = jnp.abs(places[:, None] - nodes[None])
    near = 1 + x**2 * (-7 / 3 + x * 4 / 3)
    middle = 5 / 2 + x * (-59 / 12 + x * (3 - x * 7 / 12))
    far = -3 / 2 + x * (7 / 4 + x * (-2 / 3 + x / 12))
    pieces = [x < 1, x < 2, x < 3]
    return jnp.select(pieces, [near, middle, far], 0.0)


class EddySource(AbstractSource):
    r"""Eddy currents of a uniform axial field, $Q = \tfrac12\sigma(\pi\mu_0 r H f)^2$.

    Attributes:
        radius: $r$ of the current loop [m]: of the body there, not of the tumour.
        conductivity: $\sigma$ [S m⁻¹].

    References:
        Atkinson, Brezovich and Chakraborty, IEEE Trans. Biomed. Eng. 31, 70 (1984).
    """

    radius: Scalar = eqx.field(metadata={"range": Length})
    conductivity: Scalar = eqx.field(metadata={"range": Siemens})

    def shape(self, grid: AbstractGrid) -> Field:
        return jnp.ones(grid.shape)

    def level(self, amplitude: Scalar, frequency: Scalar) -> Float[Array, ""]:
        return eddy_power(self.radius, self.conductivity, amplitude * frequency)


class DistantEddySource(AbstractSource):
    r"""Eddy currents about an axis, $Q = \tfrac12\sigma(\pi\mu_0 s H f)^2$.

    $s$ is the distance of each cell from the axis of the body, along which the field
    lies: the heat that grows with the radius, where `EddySource` takes one radius for
    all of the grid.

    Attributes:
        conductivity: $\sigma$ [S m⁻¹].
        axis: place at which the axis meets the plane of the first two edges of a box
            [m]; the middle of the grid unless given.

    References:
        Atkinson, Brezovich and Chakraborty, IEEE Trans. Biomed. Eng. 31, 70 (1984).
    """

    conductivity: Scalar = eqx.field(metadata={"range": Siemens})
    axis: tuple[float, float] | None = eqx.field(
        static=True, default=None, metadata={"range": tuple[Place, Place]}
    )

    def shape(self, grid: AbstractGrid) -> Field:
        return axis_distance(grid, self.axis) ** 2

    def level(self, amplitude: Scalar, frequency: Scalar) -> Float[Array, ""]:
        return eddy_power(1.0, self.conductivity, amplitude * frequency)


def axis_distance(grid: AbstractGrid, center: Numbers | None = None) -> Field:
    """Distance [m] of each cell from the axis of the body, for `DistantEddySource`.

    The axis is that of a cylinder; in a plane it is normal to it, and in a box parallel
    to the last edge. It meets the plane of the first two edges at a center [m], the
    middle of the grid unless given.
    """
    if isinstance(grid, RadialGrid):
        if grid.exponent != 1:
            raise InputError(
                "axis_distance: expected a cylinder or a box, about whose axis eddy "
                "currents flow, got another grid; take EddySource"
            )
        return grid.distances(center)
    assert isinstance(grid, CartesianGrid)
    plane = CartesianGrid(grid.cells[:2], grid.spacing[:2])
    shape = *plane.cells, *(1 for _ in grid.cells[2:])
    return jnp.broadcast_to(plane.distances(center).reshape(shape), grid.cells)


def eddy_power(
    radius: Scalar, conductivity: Scalar, product: Scalar
) -> Float[Array, ""]:
    r"""$\tfrac12\sigma(\pi\mu_0)^2 r^2 (Hf)^2$ [W m⁻³]."""
    loop = np.pi * VACUUM_PERMEABILITY * radius * product
    return jnp.asarray(0.5 * conductivity * loop**2)
