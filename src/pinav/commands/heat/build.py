"""From a case to the values that the library runs."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pinav.commands.heat import case as cases
from pinav.errors import InputError
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.boundaries import AbstractBoundary, Dirichlet, Robin, around, outer
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
    """A case as values.

    Attributes:
        model: the tissue.
        protocol: the field.
        target: volume fraction of the tumour in each cell.
        stepper: how time advances.
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


def build_case(case: cases.Case) -> CaseModel:
    """The values of a case.

    Raises:
        InputError: a number makes no sense; a unit is unknown or implausible.
    """
    grid, blood = _grid(case.grid), Blood(arterial=float(case.arterial))
    center = case.tumour.center
    target = grid.ball(float(case.tumour.radius), center=center)
    inner, outside = _tissue(case.tumour.tissue), _tissue(case.tissue)
    sources: list[AbstractSource] = [_source(case, grid, target)]
    if case.eddy is not None:
        sources.append(EddySource(case.eddy.radius, case.eddy.conductivity))
    model = Bioheat(
        grid,
        mix(target, inner, outside),
        blood,
        MixedPerfusion.on_mask(
            target,
            _perfusion(case.tumour.tissue, blood, inner),
            _perfusion(case.tissue, blood, outside),
        ),
        tuple(sources),
        _sides(case.wall, grid),
    )
    axes = len(grid.shape)
    points = np.zeros((0, axes))
    if case.probes is not None:
        points = np.array(case.probes.points, float).reshape(-1, axes)
    return CaseModel(
        model=model,
        protocol=_protocol(case.field),
        target=target,
        stepper=_stepper(case, model),
        limits=() if case.limit is None else (limit(case.limit),),
        points=points,
    )


def _grid(own) -> AbstractGrid:
    if isinstance(own, cases.Sphere):
        return RadialGrid.sphere(float(own.radius), own.cells)
    if isinstance(own, cases.Cylinder):
        return RadialGrid.cylinder(float(own.radius), own.cells)
    return CartesianGrid.cubes(own.cells, float(own.size))


def _stepper(case, model) -> AbstractStepper:
    if case.step is None:
        return default_stepper(model)
    step = float(case.step)
    return Rosenbrock(step) if len(model.grid.shape) == 1 else RKL2(longest=step)


def _tissue(own: cases.Medium) -> Tissue:
    base = None if own.preset is None else preset(own.preset).tissue
    values = {}
    for name in ("conductivity", "density", "specific_heat", "metabolic"):
        value = getattr(own, name)
        if value is None and base is None and name != "metabolic":
            raise InputError(
                f"tissue: expected a preset or {name}, got neither; presets are listed "
                "in docs/thermal.md"
            )
        inherited = 0.0 if base is None else getattr(base, name)
        values[name] = inherited if value is None else float(value)
    return Tissue(**values)


def _perfusion(own: cases.Medium, blood, tissue) -> AbstractPerfusion:
    flow = own.perfusion
    if flow.law is not None and flow.value is None:
        return lang(flow.law)
    if flow.law is not None or flow.value is None or flow.unit is None:
        raise InputError(
            "perfusion: expected a law, or a value with its unit, such as "
            '{value = 6.7e-4, unit = "1/s"}'
        )
    value = mass_perfusion(flow.value, unit=flow.unit, blood=blood, tissue=tissue)
    return ConstantPerfusion(value)


def _source(case, grid, target) -> AbstractSource:
    own, radius = case.heating, float(case.tumour.radius)
    if isinstance(own, cases.Particles):
        response = LinearResponse(
            1e-9 * own.diameter, viscosity=float("inf") if own.bound else 1e-3
        )
        sized = response if own.spread is None else LogNormalSizes(response, own.spread)
        concentration = own.concentration * target  # mg/cm³ are kg/m³
        return ParticleSource(concentration, sized, own.scale)
    distances = grid.distances(case.tumour.center)
    if own.width is not None:
        density = own.density * jnp.exp(-0.5 * (distances / own.width) ** 2)
    elif own.edge_weighted:
        shape = (0.4 + (distances / radius) ** 2) * target
        total = own.density * jnp.sum(target * grid.volumes)
        density = shape * (total / jnp.sum(shape * grid.volumes))
    else:
        density = own.density * target
    return PowerSource(density, own.reference)


def _sides(wall: cases.Wall, grid):
    side: AbstractBoundary
    if wall.exchange is not None:
        if wall.ambient is None:
            raise InputError("wall: expected an ambient temperature with an exchange")
        side = Robin(float(wall.exchange), float(wall.ambient))
    else:
        side = Dirichlet(37.0 if wall.temperature is None else float(wall.temperature))
    return outer(side) if len(grid.shape) == 1 else around(grid, side)


def _protocol(own: cases.Field) -> Piecewise:
    if min(own.amplitudes, default=-1.0) < 0 or not own.frequency > 0:
        raise InputError(
            "field: expected amplitudes >= 0 A/m and a frequency > 0 Hz, got "
            f"{list(own.amplitudes)} and {own.frequency}"
        )
    if own.on is None and own.off is None:
        return Piecewise.constant(own.times, own.amplitudes, float(own.frequency))
    if own.on is None or own.off is None or len(own.amplitudes) != 1:
        raise InputError("field: expected on and off together, with one amplitude")
    return Piecewise.on_off(
        own.amplitudes[0],
        float(own.frequency),
        on=own.on,
        off=own.off,
        duration=own.times[-1],
    )
