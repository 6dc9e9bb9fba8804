r"""Pennes' equation in conservative finite volumes.

$\rho c\,\partial_t T = \nabla\cdot(k\nabla T) + c_b w(T)(T_a - T) + Q_{met} + Q(x, t)$.
Heat crosses a face by $G = A/(\Delta_1/k_1 + \Delta_2/k_2)$, the harmonic mean, so that
what leaves one cell enters the next: $k\nabla^2 T$ would be 12 % off where $k$ jumps.

References:
    Pennes, J. Appl. Physiol. 1, 93 (1948).
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.boundaries import AbstractEnds, Passage
from pinav.thermal.grids import AbstractGrid
from pinav.thermal.perfusion import AbstractPerfusion
from pinav.thermal.quantities import Field
from pinav.thermal.sources import AbstractSource
from pinav.thermal.tissues import Blood, Tissue

COLDEST, WARMEST = 20.0, 60.0
"""Temperatures [°C] between which the steepest slope of perfusion is sought."""


class Bioheat(eqx.Module):
    """Tissue on a grid, perfused and heated.

    Attributes:
        tissue: passive properties, the same everywhere or one for each cell.
        sides: both ends of each axis, such as `boundaries.outer` makes.

    Raises:
        InputError: a property has not the shape of the grid, an axis has no sides, or
            the ends of a single axis meet.
    """

    grid: AbstractGrid
    tissue: Tissue
    blood: Blood
    perfusion: AbstractPerfusion
    sources: tuple[AbstractSource, ...]
    sides: tuple[AbstractEnds, ...]

    def __check_init__(self) -> None:
        if len(self.sides) != len(self.grid.shape):
            raise InputError(
                f"Bioheat.sides: expected {len(self.grid.shape)}, one pair for each "
                f"axis, got {len(self.sides)}"
            )
        if len(self.sides) == 1 and self.sides[0].joined:
            raise InputError(
                "Bioheat.sides: expected ends that do not meet on a grid with one "
                "axis; take a box of two axes"
            )
        for name in ("conductivity", "density", "specific_heat", "metabolic"):
            shape = np.shape(getattr(self.tissue, name))
            if shape not in ((), self.grid.shape):
                raise InputError(
                    f"Bioheat.tissue.{name}: expected a number or the shape "
                    f"{self.grid.shape} of the grid, got shape {shape}"
                )

    def levels(self, amplitude: Scalar, frequency: Scalar) -> Float[Array, " source"]:
        """Level of each source in a field of a peak [A m⁻¹] and a frequency [Hz]."""
        levels = [source.level(amplitude, frequency) for source in self.sources]
        return jnp.stack(levels) if levels else jnp.zeros(0)


class Rates(eqx.Module):
    """Rates of change of temperature and heat flows.

    Attributes:
        temperature: of each cell [K s⁻¹].
        energy: heat brought in, taken by blood, and lost through the sides [W].
    """

    temperature: Field
    energy: Float[Array, "3"]


class HeatBalance(eqx.Module):
    """The equation with everything computed that does not change in time.

    Attributes:
        inverse_capacity: one over the heat capacity of each cell [K J⁻¹].
        conductances: across all faces of each axis [W K⁻¹], the sides included.
        outside: temperatures behind both ends of each axis [°C]; none where they meet.
        inflow: what metabolism, and sides whatever the temperature, bring in [W].
        shapes: of the sources, times the volume.
    """

    inverse_capacity: Field
    conductances: tuple[Field, ...]
    outside: tuple[tuple[Scalar, Scalar] | None, ...]
    volumes: Field
    inflow: Field
    shapes: tuple[Field, ...]
    perfusion: AbstractPerfusion
    blood: Blood

    @classmethod
    def of(cls, model: Bioheat) -> "HeatBalance":
        grid, tissue, volumes = model.grid, model.tissue, model.grid.volumes

        def full(value: Any) -> Field:
            return jnp.broadcast_to(jnp.asarray(value, float), grid.shape)

        k, inflow = full(tissue.conductivity), full(tissue.metabolic) * volumes
        conductances, outside = [], []
        for axis, sides in enumerate(model.sides):
            conductance, (low, high) = _faces(grid, k, axis, sides)
            conductances.append(conductance)
            outside.append(None if sides.joined else (low.outside, high.outside))
            cells = [slice(None)] * axis
            inflow = inflow.at[*cells, :1].add(low.inflow)
            inflow = inflow.at[*cells, -1:].add(high.inflow)
        return cls(
            inverse_capacity=1 / (full(tissue.capacity) * volumes),
            conductances=tuple(conductances),
            outside=tuple(outside),
            volumes=volumes,
            inflow=inflow,
            shapes=tuple(
                full(source.shape(grid)) * volumes for source in model.sources
            ),
            perfusion=model.perfusion,
            blood=model.blood,
        )

    def sink(self, temperature: Field) -> Field:
        """What blood takes from each cell, per volume [W m⁻³]."""
        mass = self.perfusion(temperature)
        return self.blood.specific_heat * mass * (temperature - self.blood.arterial)

    def heating(self, levels: Float[Array, " source"]) -> Field:
        """What metabolism, sides of given flow and sources bring into each cell [W]."""
        heat = self.inflow
        for index, shape in enumerate(self.shapes):
            heat = heat + levels[index] * shape
        return heat

    def conduction(self, temperature: Field) -> tuple[Field, Float[Array, ""]]:
        """What conduction brings into each cell, and what leaves the sides [W]."""
        gain, lost = jnp.zeros_like(temperature), jnp.asarray(0.0)
        for axis, conductance in enumerate(self.conductances):
            count = temperature.shape[axis]
            # flux from each cell to the next: added to one, taken from the other
            inner = _part(conductance, axis, 1, count) * jnp.diff(
                temperature, axis=axis
            )
            first = _part(temperature, axis, 0, 1)
            last = _part(temperature, axis, count - 1, count)
            low, high = self.outside[axis] or (last, first)
            below = _part(conductance, axis, 0, 1) * (first - low)
            above = _part(conductance, axis, count, count + 1) * (last - high)
            # zeros around each part: joined before, they would be several times slower
            gain = gain + _pad(inner, axis, 0, 1) - _pad(inner, axis, 1, 0)
            gain = gain - _pad(below, axis, 0, count - 1)
            gain = gain - _pad(above, axis, count - 1, 0)
            lost = lost + jnp.sum(below) + jnp.sum(above)
        return gain, lost

    def rates(self, temperature: Field, levels: Float[Array, " source"]) -> Rates:
        """Rates of change, and the heat flows behind them."""
        heat, (gain, lost) = self.heating(levels), self.conduction(temperature)
        taken = self.sink(temperature) * self.volumes
        change = (gain + heat - taken) * self.inverse_capacity
        total = jnp.stack([jnp.sum(heat), jnp.sum(taken), lost])
        return Rates(change, total)

    def sink_slope(self, temperature: Field) -> Field:
        """Change of what blood takes from each cell with its temperature [W m⁻³ K⁻¹].

        The sink is local: its Jacobian is diagonal, and one tangent of ones gives it.
        """
        return jax.jvp(self.sink, (temperature,), (jnp.ones_like(temperature),))[1]

    def solve(
        self,
        diagonal: Field,
        right: Field,
        *,
        conduct: Scalar = 1.0,
        tolerance: float = 0.0,
    ) -> Field:
        """Solve a diagonal plus conduction [W K⁻¹] times a factor, which is symmetric.

        Exactly along one axis; by conjugate gradients in planes and boxes, up to a
        relative tolerance.
        """
        # linear in the temperature: sides at zero leave the matrix alone
        at_zero, _ = self.conduction(jnp.zeros_like(right))

        def times(change: Field) -> Field:
            gain, _ = self.conduction(change)
            return diagonal * change - conduct * (gain - at_zero)

        total = diagonal
        for axis, conductance in enumerate(self.conductances):
            count = right.shape[axis]
            # periodic ends are counted in the diagonal as any others
            faces = (_part(conductance, axis, i, count + i) for i in (0, 1))
            total = total + conduct * sum(faces)
        if right.ndim == 1:
            inner, zero = -conduct * self.conductances[0][1:-1], jnp.zeros(1)
            lower, upper = jnp.append(zero, inner), jnp.append(inner, zero)

            def exactly(_: Any, b: Field) -> Field:
                bands = lower, total, upper
                return jax.lax.linalg.tridiagonal_solve(*bands, b[:, None])[:, 0]

            return jax.lax.custom_linear_solve(times, right, exactly, symmetric=True)
        change, _ = jax.scipy.sparse.linalg.cg(
            times,
            right,
            tol=tolerance,
            maxiter=20 * max(right.shape),
            M=lambda b: b / total,
        )
        return change

    @property
    def fastest(self) -> Float[Array, ""]:
        r"""Bound on the rates of decay [s⁻¹], by Gershgorin's circles.

        Twice the conductances of a cell to others and once those to the outside, over
        its capacity, plus the steepest slope of its sink.
        """
        total = jnp.zeros_like(self.inverse_capacity)
        for axis, conductance in enumerate(self.conductances):
            count = total.shape[axis]
            ends = 2.0 if self.outside[axis] is None else 1.0
            first = ends * _part(conductance, axis, 0, 1)
            last = ends * _part(conductance, axis, count, count + 1)
            inner = 2 * _part(conductance, axis, 1, count)
            circle = jnp.concatenate([first, inner, last], axis=axis)
            low, high = (_part(circle, axis, i, count + i) for i in (0, 1))
            total = total + low + high

        def steeper(steepest: Field, celsius: Scalar) -> tuple[Field, None]:
            return jnp.maximum(
                steepest, self.sink_slope(jnp.full_like(total, celsius))
            ), None

        # in a scan, because all trials at once would hold a grid for each temperature
        trials = jnp.arange(COLDEST, WARMEST, 0.5)
        steepest, _ = jax.lax.scan(steeper, jnp.zeros_like(total), trials)
        return jnp.max((total + steepest * self.volumes) * self.inverse_capacity)


@eqx.filter_jit
def fastest_rate(model: Bioheat) -> Float[Array, ""]:
    """Bound on the rates of decay [s⁻¹] of a model, compiled as one."""
    return HeatBalance.of(model).fastest


def _faces(
    grid: AbstractGrid, k: Field, axis: int, sides: AbstractEnds
) -> tuple[Field, tuple[Passage, Passage]]:
    """Conductances across all faces of one axis, and what passes its ends."""
    area, resistance = grid.faces(axis), grid.half_widths(axis) / k
    count = k.shape[axis]
    # half cells in series: the harmonic mean, exact where the conductivity jumps
    series = _part(resistance, axis, 0, count - 1) + _part(resistance, axis, 1, count)
    ends = sides.passages(
        (_part(area, axis, 0, 1), _part(area, axis, count, count + 1)),
        (_part(resistance, axis, 0, 1), _part(resistance, axis, count - 1, count)),
    )
    low, high = (end.conductance for end in ends)
    inner = _part(area, axis, 1, count) / series
    return jnp.concatenate([low, inner, high], axis=axis), ends


def _part(array: Array, axis: int, start: int, stop: int) -> Array:
    return jax.lax.slice_in_dim(array, start, stop, axis=axis)


def _pad(array: Array, axis: int, before: int, after: int) -> Array:
    widths = [(0, 0, 0)] * array.ndim
    widths[axis] = (before, after, 0)
    return jax.lax.pad(array, jnp.zeros((), array.dtype), widths)
