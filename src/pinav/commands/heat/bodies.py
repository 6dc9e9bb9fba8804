"""The body of a case: its grid, its tissues and the target."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from pinav.commands.heat.case import Case
from pinav.commands.heat.geometry import Box, Meshed, Sphere
from pinav.commands.heat.matter import Blood as BloodTable
from pinav.commands.heat.matter import Medium
from pinav.thermal.grids import AbstractGrid, CartesianGrid, RadialGrid
from pinav.thermal.images import Image
from pinav.thermal.perfusion import (
    AbstractPerfusion,
    ConstantPerfusion,
    MixedPerfusion,
    TabulatedPerfusion,
    lang,
    mass_perfusion,
)
from pinav.thermal.quantities import Field
from pinav.thermal.tissues import Blood, Tissue, mix, preset

PROPERTIES = ("conductivity", "density", "specific_heat", "metabolic")


class Body(eqx.Module):
    """What a case is made of, but for what heats it.

    Attributes:
        grid: the cells.
        tissue: their passive properties.
        blood: that perfuses them.
        perfusion: of all tissues.
        fractions: volume fraction of each tissue in each cell.
        laws: where a model keeps the perfusion of each tissue.
        target: volume fraction of the target in each cell.
        middle: of the target [m]; none on grids whose target is in the middle.
        image: of the labels, where the cells are voxels.
    """

    grid: AbstractGrid
    tissue: Tissue
    blood: Blood
    perfusion: AbstractPerfusion
    fractions: dict[str, Field]
    laws: dict[str, Callable[[Any], Any]] = eqx.field(static=True)
    target: Field
    middle: tuple[float, ...] | None = None
    image: Image | None = None


def ball_body(case: Case, grid: Meshed) -> Body:
    """A ball of tumour in tissue.

    Raises:
        InputError: a name or a unit is unknown, or a perfusion implausible.
    """
    cells, blood = build_grid(grid), build_blood(case.blood)
    medium, tumour = case.ball
    target = cells.ball(tumour.radius, center=tumour.center)
    inside, outside = passive_properties(tumour.tissue), passive_properties(medium)
    return Body(
        grid=cells,
        tissue=mix(target, inside, outside),
        blood=blood,
        perfusion=MixedPerfusion.on_mask(
            target,
            perfusion_law(tumour.tissue, blood, inside),
            perfusion_law(medium, blood, outside),
        ),
        fractions={"tumour": target, "tissue": 1 - target},
        laws={
            "tumour": lambda m: m.perfusion.inside,
            "tissue": lambda m: m.perfusion.outside,
        },
        target=target,
        middle=tumour.center,
    )


def build_grid(grid: Meshed) -> AbstractGrid:
    """The cells of a grid."""
    if isinstance(grid, Box):
        return CartesianGrid(grid.cells, grid.sizes)
    if isinstance(grid, Sphere):
        return RadialGrid.sphere(grid.radius, grid.cells)
    return RadialGrid.cylinder(grid.radius, grid.cells)


def build_blood(blood: BloodTable) -> Blood:
    """The blood of a case."""
    return Blood(blood.density, blood.specific_heat, blood.arterial)


def passive_properties(
    medium: Medium, maps: dict[str, np.ndarray] | None = None
) -> Tissue:
    """Properties of a tissue: its own numbers, those of its preset, or of maps.

    Raises:
        InputError: the preset is unknown.
    """
    base = None if medium.preset is None else preset(medium.preset).tissue
    values = {}
    for name in PROPERTIES:
        value = getattr(medium, name)
        inherited = 0.0 if base is None else getattr(base, name)
        values[name] = inherited if value is None else value
    for name, numbers in (maps or {}).items():
        values[name] = jnp.asarray(numbers)
    return Tissue(**values)


def perfusion_law(medium: Medium, blood: Blood, tissue: Tissue) -> AbstractPerfusion:
    """The perfusion that a tissue names, or the number that it gives.

    Raises:
        InputError: there is no such law or unit, or the perfusion is implausible.
    """
    flow = medium.perfusion
    if flow.law is not None:
        return lang(flow.law)
    assert flow.unit is not None
    if flow.values:
        masses = [
            mass_perfusion(one, unit=flow.unit, blood=blood, tissue=tissue)
            for one in flow.values
        ]
        return TabulatedPerfusion(flow.temperatures, jnp.asarray(masses))
    assert flow.value is not None
    value = mass_perfusion(flow.value, unit=flow.unit, blood=blood, tissue=tissue)
    return ConstantPerfusion(value)
