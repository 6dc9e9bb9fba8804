"""Cases of bioheat: what a TOML file may say, strictly."""

import math
import os
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import msgspec

from pinav.errors import InputError
from pinav.files import read_toml
from pinav.thermal import case_geometry, quantities
from pinav.thermal.boundaries import AbstractBoundary, AbstractEnds, Sides, outer
from pinav.thermal.case_matter import (
    FieldTable,
    Heating,
    LimitName,
    Measured,
    Medium,
    Power,
    heating_file,
)
from pinav.thermal.dose import DAMAGES, Arrhenius
from pinav.thermal.grids import AbstractGrid
from pinav.thermal.quantities import Strict, explain, read_module
from pinav.thermal.sources import EddySource
from pinav.thermal.tissues import Blood

ARRAYS = 40
"""Numbers that a run keeps for each cell, about."""

MOST_STEPS = 1_000_000
"""Time steps of a run."""

USUAL_STEP = 7.5
"""Time step [s] where the case names none."""


class Tumour(Strict, frozen=True):
    """A ball of another tissue; its centre [m] is that of the grid unless given."""

    radius: quantities.Length
    tissue: Medium
    center: tuple[quantities.Place, ...] | None = None


class FromFile(Strict, frozen=True):
    """A file: the share of each voxel that the target has, or the end of a run.

    A run begins from its results, or from temperatures [°C] in a file of NumPy.
    """

    file: str


class Case(Strict, frozen=True):
    """One case: tissue, heating and field, and what is asked."""

    title: str
    grid: case_geometry.Grid
    heating: Heating
    field: FieldTable
    tissue: Medium | None = None
    tumour: Tumour | None = None
    tissues: dict[str, Medium] = msgspec.field(default_factory=dict)
    target: tuple[str, ...] | FromFile | None = None
    blood_table: quantities.Table = msgspec.field(default_factory=dict, name="blood")
    wall_table: case_geometry.Side = msgspec.field(
        default_factory=lambda: {"temperature": 37.0}, name="wall"
    )
    sides: case_geometry.SideTables = case_geometry.SideTables()
    start: Literal["rest", "steady"] | FromFile = "rest"
    eddy_table: quantities.Table | None = msgspec.field(default=None, name="eddy")
    damage_table: quantities.Table | None = msgspec.field(default=None, name="damage")
    limit: LimitName | None = None
    probes: case_geometry.Probes | None = None
    learn: case_geometry.Learn | None = None
    optimise: case_geometry.Optimise | None = None
    step: quantities.Time | None = None

    def __post_init__(self) -> None:
        # refuses tables that state none
        _ = self.blood, self.eddy, self.damage, self.boundaries(3)
        if isinstance(self.grid, case_geometry.Voxels):
            self._check_labels()
        else:
            self._check_ball(self.grid.build())
        if isinstance(self.heating, Measured):
            self._check_table(self.heating)
        if self.optimise is not None:
            self._check_bounds(self.optimise)

    @property
    def blood(self) -> Blood:
        return read_module("blood", (Blood,), self.blood_table)

    @property
    def wall(self) -> AbstractBoundary:
        """Boundary of all outer sides that the case does not state."""
        return case_geometry.read_boundary("wall", self.wall_table)

    @property
    def eddy(self) -> EddySource | None:
        """Eddy currents, of one radius or about an axis."""
        table = self.eddy_table
        return None if table is None else read_module("eddy", (EddySource,), table)

    @property
    def damage(self) -> Arrhenius | None:
        """Law of damage: a set of constants by its name, or its constants."""
        table = self.damage_table
        if table is None:
            return None
        if table.keys() == {"law"} and str(table["law"]) in DAMAGES:
            return DAMAGES[str(table["law"])]
        try:
            return read_module("damage", (Arrhenius,), table)
        except ValueError as error:
            names = ", ".join(DAMAGES)
            raise ValueError(f"{error}; or the key law, one of {names}") from error

    def boundaries(self, axes: int) -> tuple[AbstractEnds, ...]:
        """Both ends of each axis of a grid."""
        if axes == 1:
            return outer(self.wall)
        return self.sides.build(self.wall, axes)

    def check_extent(self, grid: AbstractGrid) -> None:
        """Refuse sides, probes and a size that do not go with the cells of a grid."""
        case_geometry.check_sides(grid, self.sides)
        self._check_center(grid)
        self._check_size(grid)
        self._check_probes(grid)

    @property
    def ball(self) -> tuple[Medium, Tumour]:
        """The tissue and the tumour of a case without voxels."""
        assert self.tissue is not None
        assert self.tumour is not None
        return self.tissue, self.tumour

    @property
    def _outside(self) -> list[float]:
        """Temperatures behind the sides that have one [°C], and of the arteries."""
        pairs = [one for one in self.boundaries(3) if isinstance(one, Sides)]
        one = jnp.ones(())
        sides = self.wall, *(side for pair in pairs for side in (pair.low, pair.high))
        walls = [side.passage(one, one) for side in sides]
        outside = [float(wall.outside) for wall in walls if wall.conductance > 0]
        return [float(self.blood.arterial), *outside]

    def _check_ball(self, grid: AbstractGrid) -> None:
        if self.tissue is None or self.tumour is None:
            raise ValueError(
                "expected the tables tissue and tumour, got "
                f"{'no tissue' if self.tissue is None else 'no tumour'}; give both, or "
                "labels of voxels"
            )
        if self.tissues or self.target is not None:
            raise ValueError(
                "tissues, target: expected with a grid of voxels alone; remove them, "
                'or take grid.kind = "voxels"'
            )
        for name, medium in {
            "tissue": self.tissue,
            "tumour.tissue": self.tumour.tissue,
        }.items():
            if medium.label is not None:
                raise ValueError(
                    f"{name}.label: expected with a grid of voxels alone; remove it"
                )
        files = self.tissue.file, self.tumour.tissue.file, heating_file(self.heating)
        for file in files:
            if file is not None:
                raise ValueError(
                    f"expected numbers, got the file {file!r}; maps need a grid of "
                    "voxels"
                )
        case_geometry.check_ball(
            grid, self.tumour.radius, self.tumour.center, self.sides
        )
        self.check_extent(grid)

    def _check_labels(self) -> None:
        if self.tissue is not None or self.tumour is not None:
            raise ValueError(
                "tissue, tumour: expected none on a grid of voxels; name each tissue "
                "in a table such as [tissues.muscle], and the target in target"
            )
        if not self.tissues or not self.target:
            raise ValueError(
                "expected tables of tissues and a target on a grid of voxels, got "
                f"{'no target' if self.tissues else 'no tissues'}; give "
                '[tissues.NAME] with their labels, and target = ["NAME"]'
            )
        labels = [medium.label for medium in self.tissues.values()]
        if None in labels or len(set(labels)) < len(labels):
            raise ValueError(
                f"tissues: expected a different label for each, got {labels}; give "
                "the value that the tissue has in the image"
            )
        names = self.target if isinstance(self.target, tuple) else ()
        if len(set(names)) < len(names):
            raise ValueError(f"target: expected each tissue once, got {list(names)}")
        for name in names:
            if name not in self.tissues:
                raise ValueError(
                    f"target: expected names of tissues, {', '.join(self.tissues)}; "
                    f"got {name!r}"
                )
        shape = isinstance(self.heating, Power) and self.heating.edge_weighted
        if shape or (self.optimise is not None and self.optimise.placement is not None):
            raise ValueError(
                "heating.edge_weighted, optimise.placement: expected none on a grid of "
                "voxels, whose target is no ball; give maps of the heating"
            )

    def _check_center(self, grid: AbstractGrid) -> None:
        center = self.heating.center if isinstance(self.heating, Power) else None
        if center is None:
            return
        if len(grid.shape) == 1:
            raise ValueError(
                "heating.center: expected none on a sphere or cylinder, which is "
                "heated about its centre; take a box for another place"
            )
        case_geometry.check_point("heating.center", center, grid.extent)

    def _check_probes(self, grid: AbstractGrid) -> None:
        if self.probes is None:
            return
        for point in self.probes.points:
            case_geometry.check_point("probes.points", point, grid.extent)
        if self.probes.every > self.field.duration:
            raise ValueError(
                f"probes.every: expected within the protocol, <= "
                f"{self.field.duration:g} s, got {self.probes.every:g} s; read more "
                "often"
            )

    def _check_size(self, grid: AbstractGrid) -> None:
        if self.step is not None and self.step > self.field.duration:
            raise ValueError(
                f"step: expected within the protocol, <= {self.field.duration:g} s, "
                f"got {self.step:g} s; take a shorter one, or leave it out"
            )
        every = USUAL_STEP if self.probes is None else self.probes.every
        step = min(self.step or USUAL_STEP, every)
        if (steps := self.field.duration / step) > MOST_STEPS:
            raise ValueError(
                f"expected at most {MOST_STEPS:,} time steps, got {steps:,.0f} of "
                f"{step:g} s until {self.field.duration:g} s; take a longer step, read "
                "the probes less often, or end earlier"
            )
        probes = 0 if self.probes is None else len(self.probes.points)
        count = math.prod(grid.shape)
        needed = 8 * count * (ARRAYS + probes)
        if needed > (memory := machine_memory()):
            raise ValueError(
                f"grid.cells: expected a grid that fits the memory of this machine, "
                f"{memory / 2**30:.3g} GiB, got {count:,} cells, which need "
                f"about {needed / 2**30:.3g} GiB; take larger cells"
            )

    def _check_table(self, measured: Measured) -> None:
        """Refuse a field of which a measured table says nothing."""
        low, high = measured.frequencies[0], measured.frequencies[-1]
        if not low <= self.field.frequency <= high:
            raise ValueError(
                f"field.frequency: expected within heating.frequencies, {low:g} to "
                f"{high:g} Hz, got {self.field.frequency:g} Hz; measure there"
            )
        strongest = max(self.field.amplitudes + self.field.ramp, default=0.0)
        if self.optimise is not None:
            strongest = max(strongest, self.optimise.largest)
        if strongest > measured.amplitudes[-1]:
            raise ValueError(
                f"heating.amplitudes: expected up to that of the field, "
                f"{strongest:g} A/m, got {measured.amplitudes[-1]:g} A/m; measure "
                "there, or lower the field"
            )

    def _check_bounds(self, settings: case_geometry.Optimise) -> None:
        if settings.max_temperature <= self.blood.arterial:
            raise ValueError(
                f"optimise.max_temperature: expected above the arterial temperature, "
                f"> {self.blood.arterial:g} °C, got {settings.max_temperature:g} °C"
            )
        if (warmest := max(self._outside)) > settings.max_temperature:
            raise ValueError(
                f"optimise.max_temperature: expected above that of the walls, "
                f"{warmest:g} °C, got {settings.max_temperature:g} °C"
            )
        if settings.after is None:
            return
        switches = self.field.times[1:-1]
        if settings.after not in switches or self.field.on or self.field.ramp:
            raise ValueError(
                "optimise.after: expected a time at which constant amplitudes change, "
                f"of {list(switches)} s, got {settings.after:g} s; add it to "
                "field.times"
            )


def machine_memory() -> float:
    """Bytes of main memory; unlimited where the system does not say."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):
        return float("inf")


def read_case(path: Path) -> tuple[Case, dict[str, Any]]:
    """A case and its content as it was written.

    Raises:
        InputError: the file cannot be read, or holds what no case has.
    """
    content = read_toml(path)
    try:
        return msgspec.convert(content, Case), content
    except msgspec.ValidationError as error:
        raise InputError(f"{path}: {explain(str(error), content)}") from error
