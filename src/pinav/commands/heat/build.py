"""The values of the library that a case describes."""

from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from pinav.commands.heat.bodies import Body, ball_body
from pinav.commands.heat.case import Case
from pinav.commands.heat.field import Field as FieldTable
from pinav.commands.heat.geometry import Across, Ends, Side, Voxels
from pinav.commands.heat.matter import (
    Absorption,
    Damage,
    Eddy,
    Measured,
    Particles,
    Power,
    heating_file,
)
from pinav.commands.heat.starting import build_start
from pinav.commands.heat.voxels import read_heating, voxel_body
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
from pinav.thermal.dose import DAMAGES, Arrhenius
from pinav.thermal.exposure_limits import HfLimit, limit
from pinav.thermal.grids import AbstractGrid, RadialGrid
from pinav.thermal.magnetics import (
    AbstractHeating,
    LinearResponse,
    LogNormalSizes,
    TabulatedHeating,
)
from pinav.thermal.protocols import Piecewise
from pinav.thermal.quantities import Field
from pinav.thermal.rosenbrock import Rosenbrock
from pinav.thermal.solve import default_stepper
from pinav.thermal.sources import (
    AbstractSource,
    DistantEddySource,
    EddySource,
    ParticleSource,
    PowerSource,
    ShiftedSource,
    axis_distance,
)
from pinav.thermal.starts import AbstractStart, AtSteadyState
from pinav.thermal.steady import find_steady_state
from pinav.thermal.steppers import RKL2, AbstractStepper


class CaseModel(eqx.Module):
    """A case as values of the library.

    Attributes:
        model: the tissue.
        protocol: the field.
        body: grid, tissues and target.
        stepper: the method of time integration.
        limits: of the field.
        points: of the probes [m], none if there are none.
        start: where a run begins.
        damage: law of damage that is added up, if any.
    """

    model: Bioheat
    protocol: Piecewise
    body: Body
    stepper: AbstractStepper
    limits: tuple[HfLimit, ...]
    points: np.ndarray
    start: AbstractStart
    damage: Arrhenius | None = None

    @property
    def target(self) -> Field:
        """Volume fraction of the target in each cell."""
        return self.body.target


def build_case(case: Case, folder: Path) -> CaseModel:
    """The values of a case.

    Args:
        case: the case.
        folder: in which the files that it names are.

    Raises:
        InputError: a name or a unit is unknown, a perfusion implausible, or a file
            cannot be read.
    """
    body = (
        voxel_body(case, case.grid, folder)
        if isinstance(case.grid, Voxels)
        else ball_body(case, case.grid)
    )
    grid = body.grid
    start = build_start(case.start, grid.shape, folder)
    sources: list[AbstractSource] = [_source(case, body, folder)]
    if case.eddy is not None:
        sources.append(_eddy(case.eddy, grid))
    model = Bioheat(
        grid,
        body.tissue,
        body.blood,
        body.perfusion,
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
        body=body,
        stepper=stepper,
        limits=limits,
        points=np.array(points, float).reshape(-1, axes),
        start=start,
        damage=_damage(case.damage),
    )


def _damage(table: Damage | None) -> Arrhenius | None:
    if table is None:
        return None
    if table.law is not None:
        return DAMAGES[table.law]
    assert table.log_factor is not None
    assert table.energy is not None
    return Arrhenius(table.log_factor, table.energy)


def _stepper(case: Case, model: Bioheat) -> AbstractStepper:
    if case.step is None:
        return default_stepper(model)
    if len(model.grid.shape) == 1:
        return Rosenbrock(case.step)
    return RKL2.for_step(model, case.step)


def _source(case: Case, body: Body, folder: Path) -> AbstractSource:
    heating = case.heating
    if isinstance(heating, Power):
        return PowerSource(_density(case, heating, body), heating.reference)
    file = heating_file(heating)
    values = None if file is None else read_heating(heating, folder / file, body)
    if isinstance(heating, Absorption):
        assert values is not None
        absorption = jnp.asarray(values)
        source = PowerSource(absorption, heating.reference, heating.scale)
        return ShiftedSource(source, jnp.zeros(values.ndim), body.tissue.density)
    concentration = values
    if not isinstance(heating.concentration, str):
        concentration = heating.concentration * body.target  # mg/cm³ are kg/m³
    table: AbstractHeating = (
        _response(heating) if isinstance(heating, Particles) else _measurements(heating)
    )
    return ParticleSource(jnp.asarray(concentration), table, heating.scale)


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


def _density(case: Case, power: Power, body: Body) -> Field:
    """Power density of each cell [W m⁻³]."""
    grid, target = body.grid, body.target
    if power.width is not None:
        center = body.middle if power.center is None else power.center
        distances = grid.distances(center)
        return power.density * jnp.exp(-0.5 * (distances / power.width) ** 2)
    if not power.edge_weighted:
        return power.density * target
    distances = grid.distances(body.middle)
    shape = (0.4 + (distances / case.ball[1].radius) ** 2) * target
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


def _protocol(field: FieldTable) -> Piecewise:
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
