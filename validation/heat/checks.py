"""What the solver is verified with: a reference medium, its powers, and one check."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from pinav.report import Table
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.boundaries import AbstractEnds, Dirichlet, around, outer
from pinav.thermal.grids import AbstractGrid
from pinav.thermal.perfusion import AbstractPerfusion, ConstantPerfusion
from pinav.thermal.protocols import Piecewise
from pinav.thermal.quantities import Field, Number, Numbers
from pinav.thermal.solve import probes_at
from pinav.thermal.sources import PowerSource
from pinav.thermal.tissues import Blood, Tissue

AMPLITUDE = 1e4
"""Field [A m⁻¹] at which a power density is what it says."""


class Check(eqx.Module):
    """One quantity of one case.

    Attributes:
        case: name of the case, and where the quantity is taken.
        value: its value by the solver.
        exact: its exact value.
        tolerance: largest difference that a second-order scheme is allowed here.
        unit: of all three.
    """

    case: str = eqx.field(static=True)
    value: Number
    exact: Number
    tolerance: Number
    unit: str = eqx.field(static=True)

    @property
    def error(self) -> float:
        """Absolute difference."""
        return abs(self.value - self.exact)

    @property
    def within(self) -> bool:
        """Whether it is within the tolerance."""
        return self.error <= self.tolerance


def reference_model(
    grid: AbstractGrid,
    power: Number | Numbers,
    sides: tuple[AbstractEnds, ...] | None = None,
    perfusion: Number | AbstractPerfusion = 1.05,
    tissue: Tissue | None = None,
) -> Bioheat:
    """The reference medium on a grid, heated by a power density [W m⁻³].

    Args:
        grid: the cells.
        power: at the reference amplitude.
        sides: held at 37 °C, radial grids at their outer end alone, unless given.
        perfusion: a law, or its constant value [kg m⁻³ s⁻¹].
        tissue: that of the reference medium unless given.
    """
    if sides is None:
        wall = Dirichlet(37.0)
        sides = outer(wall) if len(grid.shape) == 1 else around(grid, wall)
    if not isinstance(perfusion, AbstractPerfusion):
        perfusion = ConstantPerfusion(perfusion)
    density = jnp.broadcast_to(jnp.asarray(power, float), grid.shape)
    return Bioheat(
        grid,
        Tissue(0.5, 1050.0, 3600.0) if tissue is None else tissue,
        Blood(),
        perfusion,
        (PowerSource(density, AMPLITUDE),),
        sides,
    )


def powers(edges: Numbers, factors: Numbers) -> Piecewise:
    """A protocol of powers relative to the reference, one for each interval."""
    amplitudes = AMPLITUDE * jnp.sqrt(jnp.asarray(factors, float))
    return Piecewise.constant(edges, amplitudes, 1e5)


def checks_at(
    case: str, points: Any, values: Any, true: Any, tolerance: float
) -> Iterator[Check]:
    """One check of a rise [K] for each point [m].

    Args:
        case: its name.
        points: where the values are taken [m].
        values: by the solver.
        true: exact ones.
        tolerance: of each.
    """
    for point, value, expected in zip(points, values, true, strict=True):
        name = f"{case}, {1e3 * point:g} mm"
        yield Check(name, float(value), float(expected), tolerance, "K")


def checks_along(
    case: str,
    model: Bioheat,
    temperature: Field,
    solution: Callable[[np.ndarray], Any],
    tolerance: float,
    *,
    points: Sequence[float] = (0.0, 0.01, 0.02),
    every: int = 1,
) -> Iterator[Check]:
    """Checks along a radius: probes at points, and the cell with the largest error.

    Args:
        case: its name.
        model: on a grid along a radius.
        temperature: by the solver [°C].
        solution: exact rises [K] at places [m].
        tolerance: of each check.
        points: of the probes [m].
        every: so many cells one is compared, of a solution that takes long.
    """
    at = np.asarray(points)
    rise = probes_at(model, at)(temperature) - 37.0
    yield from checks_at(case, at, rise, solution(at), tolerance)
    places = np.asarray(model.grid.distances())[::every]
    rises, true = np.asarray(temperature)[::every] - 37.0, np.asarray(solution(places))
    worst = int(np.abs(rises - true).argmax())
    name = f"{case}, worst of {len(places)} cells"
    one = slice(worst, worst + 1)
    yield from checks_at(name, places[one], rises[one], true[one], tolerance)


def table(checks: Sequence[Check]) -> Table:
    """The errors of the solver, one row for each check."""
    rows = [
        (
            f"{check.case} [{check.unit}]",
            check.value,
            check.exact,
            f"{check.error:.1e}",
            f"{check.tolerance:.0e}",
            "yes" if check.within else "NO",
        )
        for check in checks
    ]
    return Table(("case", "value", "exact", "error", "tolerance", "within"), rows)
