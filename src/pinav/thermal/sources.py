r"""Sources of heat: a shape in space times a level of the field; magnetic particles.

The peak amplitude $H$ [A m⁻¹] and the frequency $f$ [Hz] of the field make the specific
loss power (SLP) [W kg⁻¹], per mass of the particles' solid. A measured value per mass
of iron belongs to a concentration of iron.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar, check_positive
from pinav.errors import InputError
from pinav.thermal.grids import AbstractGrid, CartesianGrid, RadialGrid
from pinav.thermal.quantities import Field, Length, Numbers, Place, Siemens
from pinav.thermal.tissues import Property

VACUUM_PERMEABILITY = 4e-7 * np.pi
"""$\\mu_0$ [T m A⁻¹]."""

BOLTZMANN = 1.380649e-23
"""$k_B$ [J K⁻¹]."""


class AbstractHeating(eqx.Module):
    """How particles turn a field into heat."""

    @abc.abstractmethod
    def slp(self, amplitude: Scalar, frequency: Scalar) -> Float[Array, ""]:
        """Power per mass of particles [W kg⁻¹]."""

    @abc.abstractmethod
    def validity(self, amplitude: Scalar) -> Float[Array, ""]:
        """How far the law is strained at `amplitude`: above 1 it does not hold."""


class LinearResponse(AbstractHeating):
    r"""Rosensweig's linear response of single-domain particles of one size.

    $P = \pi\mu_0\chi'' f H^2$, $\chi'' = \chi_0\,\omega\tau/(1+(\omega\tau)^2)$,
    $\tau^{-1} = \tau_N^{-1} + \tau_B^{-1}$, with the chord susceptibility
    $\chi_0 = \chi_i\,\tfrac{3}{\xi}(\coth\xi - 1/\xi)$. Linear response needs
    $\xi = \mu_0 M_d H V/(k_B T) < 1$; `validity` returns it. At a fixed product $Hf$
    the power falls with $f$ wherever $\chi_0$ is taken as constant: an optimiser that
    runs to the largest amplitude found that artefact.

    Attributes:
        diameter: of the magnetic core [m].
        anisotropy: $K$ [J m⁻³].
        magnetisation: $M_d$ of the domains [A m⁻¹].
        attempt_time: $\tau_0$ [s].
        viscosity: of the carrier [Pa s]; infinite where particles are bound to tissue.
        coating: thickness $\delta$ of the shell [m].

    Raises:
        InputError: a number is not positive.

    References:
        Rosensweig, J. Magn. Magn. Mater. 252, 370 (2002); Carrey, Mehdaoui and
        Respaud, J. Appl. Phys. 109, 083921 (2011), for the range of validity.
    """

    diameter: Scalar
    anisotropy: Scalar = 23e3
    magnetisation: Scalar = 446e3
    attempt_time: Scalar = 1e-9
    viscosity: Scalar = 1e-3
    coating: Scalar = 2e-9
    density: Scalar = 5180.0
    temperature: Scalar = 310.15

    def __check_init__(self) -> None:
        check_positive(self, "diameter", "anisotropy", "magnetisation", "density")
        if isinstance(self.diameter, float) and self.diameter > 1e-6:
            raise InputError(
                f"LinearResponse.diameter: expected metres, such as 14e-9, got "
                f"{self.diameter}"
            )

    @property
    def _energy(self) -> Any:
        return BOLTZMANN * self.temperature

    @property
    def _volume(self) -> Any:
        return np.pi / 6 * self.diameter**3

    @property
    def neel_time(self) -> Scalar:
        r"""$\tau_N = \frac{\sqrt\pi}{2}\tau_0\,e^\Gamma/\sqrt\Gamma$ [s]."""
        barrier = jnp.asarray(self.anisotropy * self._volume / self._energy)
        prefactor = 0.5 * np.sqrt(np.pi) * self.attempt_time
        return prefactor * jnp.exp(barrier) / jnp.sqrt(barrier)

    @property
    def brown_time(self) -> Scalar:
        r"""$\tau_B = 3\eta V_H/(k_B T)$ [s]."""
        hydrodynamic = np.pi / 6 * (self.diameter + 2 * self.coating) ** 3
        return 3 * self.viscosity * hydrodynamic / self._energy

    @property
    def relaxation_time(self) -> Scalar:
        r"""$\tau = 1/(1/\tau_N + 1/\tau_B)$ [s]."""
        return 1 / (1 / self.neel_time + 1 / self.brown_time)

    def validity(self, amplitude: Scalar) -> Float[Array, ""]:
        moment = VACUUM_PERMEABILITY * self.magnetisation * self._volume
        return jnp.asarray(moment * amplitude / self._energy)

    def susceptibility(self, amplitude: Scalar) -> Float[Array, ""]:
        r"""$\chi_0$ of the solid at this amplitude, one at volume fraction 1."""
        initial = VACUUM_PERMEABILITY * self.magnetisation**2 * self._volume
        return initial / (3 * self._energy) * langevin_ratio(self.validity(amplitude))

    def slp(self, amplitude: Scalar, frequency: Scalar) -> Float[Array, ""]:
        phase = 2 * np.pi * frequency * self.relaxation_time
        loss = self.susceptibility(amplitude) * phase / (1 + phase**2)
        power = np.pi * VACUUM_PERMEABILITY * loss * frequency * amplitude**2
        return jnp.asarray(power / self.density)


def langevin_ratio(field: Field) -> Field:
    r"""$\frac{3}{\xi}(\coth\xi - 1/\xi)$, one at zero."""
    small = jnp.abs(field) < 1e-2
    safe = jnp.where(small, 1.0, field)
    series = 1 - field**2 / 15 + 2 * field**4 / 315
    return jnp.where(small, series, 3 / safe * (1 / jnp.tanh(safe) - 1 / safe))


class LogNormalSizes(AbstractHeating):
    r"""A distribution of sizes: number log-normal, $d = d_m e^{sz}$, $z \sim N(0, 1)$.

    The power per mass is $E[d^3\,\mathrm{SLP}(d)]/E[d^3]$, by the trapezoidal rule
    about where the mass is: the SLP rises 240-fold between 10 and 16 nm and falls
    again, too sharply for the nodes of Gauss and Hermite. `validity` is that of the
    size that carries the median mass.

    Attributes:
        median: particles of the median size $d_m$.
        spread: $s$, standard deviation of $\ln d$.
        num_nodes: of the rule, over sixteen standard deviations.

    Raises:
        InputError: `spread` is a number <= 0.
    """

    median: LinearResponse
    spread: Scalar
    num_nodes: int = eqx.field(static=True, default=401)

    def __check_init__(self) -> None:
        if isinstance(self.spread, float | int) and not self.spread > 0:
            raise InputError(
                f"LogNormalSizes.spread: expected > 0, got {self.spread}; use "
                "LinearResponse for one size"
            )

    def _with_diameter(self, diameter: Any) -> Any:
        return eqx.tree_at(lambda p: p.diameter, self.median, diameter)

    def validity(self, amplitude: Scalar) -> Float[Array, ""]:
        heavy = self.median.diameter * jnp.exp(3 * jnp.asarray(self.spread) ** 2)
        return self._with_diameter(heavy).validity(amplitude)

    def slp(self, amplitude: Scalar, frequency: Scalar) -> Float[Array, ""]:
        nodes = np.linspace(-8.0, 8.0, self.num_nodes)
        weights = np.exp(-0.5 * nodes**2)
        # d³ N(z) is a normal density about 3s: the mass average has no other factor
        shifted = jnp.asarray(nodes) + 3 * jnp.asarray(self.spread)
        diameters = self.median.diameter * jnp.exp(self.spread * shifted)
        each = jax.vmap(lambda d: self._with_diameter(d).slp(amplitude, frequency))
        return jnp.asarray(weights / weights.sum()) @ each(diameters)


class TabulatedHeating(AbstractHeating):
    r"""Measured SLP on a grid of amplitudes and frequencies, bilinear between them.

    Below the smallest amplitude the SLP falls with $H^2$, outside the frequencies it is
    that of the nearest one. `validity` is the amplitude over the largest measured one.

    Attributes:
        amplitudes: increasing [A m⁻¹], positive.
        frequencies: increasing [Hz].
        values: SLP [W kg⁻¹].

    Raises:
        InputError: the axes do not increase, or the table has not their shape.
    """

    amplitudes: Float[Array, " amplitude"] = eqx.field(converter=jnp.asarray)
    frequencies: Float[Array, " frequency"] = eqx.field(converter=jnp.asarray)
    values: Float[Array, "amplitude frequency"] = eqx.field(converter=jnp.asarray)

    def __check_init__(self) -> None:
        check_increasing(self, "amplitudes", "frequencies")

    def slp(self, amplitude: Scalar, frequency: Scalar) -> Float[Array, ""]:
        strength = jnp.asarray(amplitude, float)
        rows = jax.vmap(lambda row: jnp.interp(frequency, self.frequencies, row))
        column = rows(self.values)
        low = jnp.minimum(strength / self.amplitudes[0], 1.0) ** 2
        return low * jnp.interp(strength, self.amplitudes, column)

    def validity(self, amplitude: Scalar) -> Float[Array, ""]:
        return jnp.asarray(amplitude / self.amplitudes[-1])


def check_increasing(table: Any, *names: str) -> None:
    """Refuse axes of a table that are empty, not positive or not in order."""
    for name in names:
        axis = np.asarray(getattr(table, name), float)
        if not (axis.size and np.all(axis > 0) and np.all(np.diff(axis) > 0)):
            raise InputError(
                f"{name}: expected increasing numbers > 0, got {axis.tolist()}; sort "
                "the table"
            )


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
    r"""Eddy currents of a uniform axial field, $Q = \tfrac12\sigma(\pi\mu_0 s H f)^2$.

    $s$ is the distance of each cell from the axis of the body, along which the field
    lies, or one radius for all of the grid.

    Attributes:
        conductivity: $\sigma$ [S m⁻¹].
        radius: of the current loop [m]: of the body there, not of the tumour; the
            distance from the axis unless given.
        axis: place at which the axis meets the plane of the first two edges of a box
            [m]; the middle of the grid unless given.

    Raises:
        InputError: both radius and axis are given.

    References:
        Atkinson, Brezovich and Chakraborty, IEEE Trans. Biomed. Eng. 31, 70 (1984).
    """

    conductivity: Scalar = eqx.field(metadata={"range": Siemens})
    radius: Scalar | None = eqx.field(default=None, metadata={"range": Length})
    axis: tuple[float, float] | None = eqx.field(
        static=True, default=None, metadata={"range": tuple[Place, Place]}
    )

    def __check_init__(self) -> None:
        if self.radius is not None and self.axis is not None:
            raise InputError("expected a radius or an axis, got both; remove one")

    def shape(self, grid: AbstractGrid) -> Field:
        if self.radius is None:
            return axis_distance(grid, self.axis) ** 2
        return jnp.full(grid.shape, jnp.asarray(self.radius, float) ** 2)

    def level(self, amplitude: Scalar, frequency: Scalar) -> Float[Array, ""]:
        return eddy_power(1.0, self.conductivity, amplitude * frequency)


def axis_distance(grid: AbstractGrid, center: Numbers | None = None) -> Field:
    """Distance [m] of each cell from the axis of the body, for `EddySource`.

    The axis is that of a cylinder; in a plane it is normal to it, and in a box parallel
    to the last edge. It meets the plane of the first two edges at a center [m], the
    middle of the grid unless given.
    """
    if isinstance(grid, RadialGrid):
        if grid.exponent != 1:
            raise InputError(
                "axis_distance: expected a cylinder or a box, about whose axis eddy "
                "currents flow, got another grid; give a radius"
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
