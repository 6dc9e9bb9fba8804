"""The values of the library that a case describes."""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.commands.heat.case import Case
from pinav.commands.heat.field import Field
from pinav.commands.heat.geometry import Across, Box, Ends, Grid, Side, Sphere
from pinav.commands.heat.matter import Eddy, Measured, Medium, Particles, Power
from pinav.commands.heat.starting import build_start
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.boundaries import (
    AbstractBoundary,
    AbstractEnds,
    Dirichlet,
    Insulated,
    Periodic,
    Robin,
    Sides,
    outer,
)
from pinav.thermal.exposure_limits import AbstractLimit, limit
from pinav.thermal.grids import AbstractGrid, CartesianGrid, RadialGrid
from pinav.thermal.magnetics import (
    AbstractHeating,
    LinearResponse,
    LogNormalSizes,
    TabulatedHeating,
)
from pinav.thermal.perfusion import (
    AbstractPerfusion,
    ConstantPerfusion,
    MixedPerfusion,
    lang,
    mass_perfusion,
)
from pinav.thermal.protocols import Piecewise
from pinav.thermal.rosenbrock import Rosenbrock
from pinav.thermal.solve import default_stepper
from pinav.thermal.sources import (
    AbstractSource,
    DistantEddySource,
    EddySource,
    ParticleSource,
    PowerSource,
    axis_distance,
)
from pinav.thermal.starts import AbstractStart, AtSteadyState
from pinav.thermal.steady import find_steady_state
from pinav.thermal.steppers import RKL2, AbstractStepper
from pinav.thermal.tissues import Blood, Tissue, mix, preset


class CaseModel(eqx.Module):
    """A case as values of the library.

    Attributes:
        model: the tissue.
        protocol: the field.
        target: volume fraction of the tumour in each cell.
        stepper: the method of time integration.
        limits: of the field.
        points: of the probes [m], none if there are none.
        start: where a run begins.
    """

    model: Bioheat
    protocol: Piecewise
    target: jax.Array
    stepper: AbstractStepper
    limits: tuple[AbstractLimit, ...]
    points: np.ndarray
    start: AbstractStart

    @property
    def perfusion(self) -> MixedPerfusion:
        """Of tumour (inside) and tissue (outside)."""
        assert isinstance(self.model.perfusion, MixedPerfusion)
        return self.model.perfusion


def build_case(case: Case, folder: Path) -> CaseModel:
    """The values of a case.

    Args:
        case: the case.
        folder: in which the files that it names are.

    Raises:
        InputError: a name or a unit is unknown, a perfusion implausible, or a file
            cannot be read.
    """
    start = build_start(case.start, case.grid, folder)
    grid = _grid(case.grid)
    blood = Blood(case.blood.density, case.blood.specific_heat, case.blood.arterial)
    target = grid.ball(case.tumour.radius, center=case.tumour.center)
    inside, outside = _tissue(case.tumour.tissue), _tissue(case.tissue)
    sources: list[AbstractSource] = [_source(case, grid, target)]
    if case.eddy is not None:
        sources.append(_eddy(case.eddy, grid))
    model = Bioheat(
        grid,
        mix(target, inside, outside),
        blood,
        MixedPerfusion.on_mask(
            target,
            _perfusion(case.tumour.tissue, blood, inside),
            _perfusion(case.tissue, blood, outside),
        ),
        tuple(sources),
        _sides(case, grid),
    )
    if isinstance(start, AtSteadyState):
        find_steady_state(model)  # refuses a case that has none
    limits = () if case.limit is None else (limit(case.limit),)
    protocol, stepper = _protocol(case.field), _stepper(case, model)
    stepper.longest_step(model)  # refuses a step that is not stable
    axes = len(grid.shape)
    points = () if case.probes is None else case.probes.points
    return CaseModel(
        model=model,
        protocol=protocol,
        target=target,
        stepper=stepper,
        limits=limits,
        points=np.array(points, float).reshape(-1, axes),
        start=start,
    )


def _grid(grid: Grid) -> AbstractGrid:
    if isinstance(grid, Box):
        return CartesianGrid.cubes(grid.cells, grid.size)
    if isinstance(grid, Sphere):
        return RadialGrid.sphere(grid.radius, grid.cells)
    return RadialGrid.cylinder(grid.radius, grid.cells)


def _stepper(case: Case, model: Bioheat) -> AbstractStepper:
    if case.step is None:
        return default_stepper(model)
    if len(model.grid.shape) == 1:
        return Rosenbrock(case.step)
    return RKL2(longest=case.step)


def _tissue(medium: Medium) -> Tissue:
    base = None if medium.preset is None else preset(medium.preset).tissue
    values = {}
    for name in ("conductivity", "density", "specific_heat", "metabolic"):
        value = getattr(medium, name)
        inherited = 0.0 if base is None else getattr(base, name)
        values[name] = inherited if value is None else value
    return Tissue(**values)


def _perfusion(medium: Medium, blood: Blood, tissue: Tissue) -> AbstractPerfusion:
    flow = medium.perfusion
    if flow.law is not None:
        return lang(flow.law)
    assert flow.value is not None
    assert flow.unit is not None
    value = mass_perfusion(flow.value, unit=flow.unit, blood=blood, tissue=tissue)
    return ConstantPerfusion(value)


def _source(
    case: Case, grid: AbstractGrid, target: Float[Array, "..."]
) -> AbstractSource:
    heating = case.heating
    if isinstance(heating, Power):
        return PowerSource(_density(case, heating, grid, target), heating.reference)
    concentration = heating.concentration * target  # mg/cm³ are kg/m³
    table: AbstractHeating = (
        _response(heating) if isinstance(heating, Particles) else _measurements(heating)
    )
    return ParticleSource(concentration, table, heating.scale)


def _response(particles: Particles) -> AbstractHeating:
    viscosity = 1e-3 if particles.viscosity is None else particles.viscosity
    response = LinearResponse(
        1e-9 * particles.diameter,
        anisotropy=1e3 * particles.anisotropy,
        magnetisation=1e3 * particles.magnetisation,
        attempt_time=particles.attempt_time,
        viscosity=float("inf") if particles.bound else viscosity,
        coating=1e-9 * particles.coating,
        density=particles.solid_density,
    )
    spread = particles.spread
    return response if spread is None else LogNormalSizes(response, spread)


def _measurements(measured: Measured) -> AbstractHeating:
    return TabulatedHeating(
        np.array(measured.amplitudes),
        np.array(measured.frequencies),
        1e3 * np.array(measured.slp),
    )


def _density(
    case: Case, power: Power, grid: AbstractGrid, target: Float[Array, "..."]
) -> Float[Array, "..."]:
    """Power density of each cell [W m⁻³]."""
    if power.width is not None:
        center = case.tumour.center if power.center is None else power.center
        distances = grid.distances(center)
        return power.density * jnp.exp(-0.5 * (distances / power.width) ** 2)
    if not power.edge_weighted:
        return power.density * target
    distances = grid.distances(case.tumour.center)
    shape = (0.4 + (distances / case.tumour.radius) ** 2) * target
    total = power.density * jnp.sum(target * grid.volumes)
    return shape * (total / jnp.sum(shape * grid.volumes))


def _eddy(eddy: Eddy, grid: AbstractGrid) -> AbstractSource:
    if eddy.radius is not None:
        return EddySource(eddy.radius, eddy.conductivity)
    return DistantEddySource(axis_distance(grid, eddy.axis), eddy.conductivity)


def _sides(case: Case, grid: AbstractGrid) -> tuple[AbstractEnds, ...]:
    wall = _boundary(case.wall)
    if isinstance(grid, RadialGrid):
        return outer(wall)
    return tuple(
        _ends(ends, wall) for ends, _ in zip(case.sides.along, grid.shape, strict=False)
    )


def _ends(ends: Across, wall: AbstractBoundary) -> AbstractEnds:
    if ends is None:
        return Sides(wall, wall)
    if not isinstance(ends, Ends):
        return Periodic()
    low, high = (
        wall if side is None else _boundary(side) for side in (ends.low, ends.high)
    )
    return Sides(low, high)


def _boundary(side: Side) -> AbstractBoundary:
    if isinstance(side, str):
        return Insulated()
    if side.exchange is not None and side.ambient is not None:
        return Robin(side.exchange, side.ambient)
    return Dirichlet(37.0 if side.temperature is None else side.temperature)


def _protocol(field: Field) -> Piecewise:
    if field.ramp:
        return Piecewise.ramp(field.times, field.ramp, field.frequency)
    if field.on is None or field.off is None:
        return Piecewise.constant(field.times, field.amplitudes, field.frequency)
    return Piecewise.on_off(
        field.amplitudes[0],
        field.frequency,
        on=field.on,
        off=field.off,
        duration=field.times[-1],
    )
