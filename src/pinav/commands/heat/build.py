"""The values of the library that a case describes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.commands.heat.case import Case
from pinav.commands.heat.field import Field
from pinav.commands.heat.geometry import Box, Grid, Sphere, Wall
from pinav.commands.heat.matter import Medium, Particles
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.boundaries import (
    AbstractBoundary,
    Dirichlet,
    Robin,
    Sides,
    around,
    outer,
)
from pinav.thermal.exposure_limits import AbstractLimit, limit
from pinav.thermal.grids import AbstractGrid, CartesianGrid, RadialGrid
from pinav.thermal.magnetics import LinearResponse, LogNormalSizes
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
    EddySource,
    ParticleSource,
    PowerSource,
)
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
    """

    model: Bioheat
    protocol: Piecewise
    target: jax.Array
    stepper: AbstractStepper
    limits: tuple[AbstractLimit, ...]
    points: np.ndarray

    @property
    def perfusion(self) -> MixedPerfusion:
        """Of tumour (inside) and tissue (outside)."""
        assert isinstance(self.model.perfusion, MixedPerfusion)
        return self.model.perfusion


def build_case(case: Case) -> CaseModel:
    """The values of a case.

    Raises:
        InputError: a name or a unit is unknown, or a perfusion implausible.
    """
    grid, blood = _grid(case.grid), Blood(arterial=case.arterial)
    target = grid.ball(case.tumour.radius, center=case.tumour.center)
    inside, outside = _tissue(case.tumour.tissue), _tissue(case.tissue)
    sources: list[AbstractSource] = [_source(case, grid, target)]
    if case.eddy is not None:
        sources.append(EddySource(case.eddy.radius, case.eddy.conductivity))
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
        _sides(case.wall, grid),
    )
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
    heating, radius = case.heating, case.tumour.radius
    if isinstance(heating, Particles):
        response = LinearResponse(
            1e-9 * heating.diameter, viscosity=float("inf") if heating.bound else 1e-3
        )
        spread = heating.spread
        sizes = response if spread is None else LogNormalSizes(response, spread)
        concentration = heating.concentration * target  # mg/cm³ are kg/m³
        return ParticleSource(concentration, sizes, heating.scale)
    distances = grid.distances(case.tumour.center)
    if heating.width is not None:
        density = heating.density * jnp.exp(-0.5 * (distances / heating.width) ** 2)
    elif heating.edge_weighted:
        shape = (0.4 + (distances / radius) ** 2) * target
        total = heating.density * jnp.sum(target * grid.volumes)
        density = shape * (total / jnp.sum(shape * grid.volumes))
    else:
        density = heating.density * target
    return PowerSource(density, heating.reference)


def _sides(wall: Wall, grid: AbstractGrid) -> tuple[Sides, ...]:
    side: AbstractBoundary
    if wall.exchange is not None and wall.ambient is not None:
        side = Robin(wall.exchange, wall.ambient)
    else:
        side = Dirichlet(37.0 if wall.temperature is None else wall.temperature)
    return outer(side) if isinstance(grid, RadialGrid) else around(grid, side)


def _protocol(field: Field) -> Piecewise:
    if field.on is None or field.off is None:
        return Piecewise.constant(field.times, field.amplitudes, field.frequency)
    return Piecewise.on_off(
        field.amplitudes[0],
        field.frequency,
        on=field.on,
        off=field.off,
        duration=field.times[-1],
    )
