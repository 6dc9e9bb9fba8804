"""What a case of `pinav heat` is made of: tissues, and what heats them."""

import itertools
from typing import Annotated, Literal

from msgspec import Meta

from pinav.commands.heat.bounds import (
    Arterial,
    Celsius,
    Concentration,
    Conductivity,
    Density,
    Frequency,
    Length,
    Magnitude,
    Place,
    PowerDensity,
    Reference,
    Scale,
    SpecificHeat,
    Strict,
)
from pinav.thermal.perfusion import BLEND


class Flow(Strict, frozen=True):
    """A perfusion: a number with its unit, or a law of Lang et al. by its tissue.

    Among voxels a `file` in a unit, too; or a law of one's own, `values` in a unit at
    `temperatures` [°C], linear between them.
    """

    law: str | None = None
    value: Magnitude | None = None
    temperatures: tuple[Celsius, ...] = ()
    values: tuple[Magnitude, ...] = ()
    file: str | None = None
    unit: str | None = None

    def __post_init__(self) -> None:
        given = [one is not None for one in (self.law, self.value, self.file)]
        given.append(bool(self.values))
        if sum(given) != 1 or (self.law is None) is (self.unit is None):
            raise ValueError(
                "expected a law, or a value with its unit, such as "
                '{value = 6.7e-4, unit = "1/s"}'
            )
        if self.values or self.temperatures:
            self._check_law()

    def _check_law(self) -> None:
        """Refuse a law that jumps: no derivative sees a jump."""
        count = len(self.temperatures)
        if len(self.values) != count or count < 2:
            raise ValueError(
                "values: expected one for each of two temperatures or more, got "
                f"{len(self.values)} for {count}"
            )
        gaps = [b - a for a, b in itertools.pairwise(self.temperatures)]
        if min(gaps) < BLEND * (1 - 1e-9):
            raise ValueError(
                f"temperatures: expected increasing, {BLEND:g} K apart or more, got "
                f"{list(self.temperatures)}; a law that jumps has no derivative there: "
                f"let it rise over {BLEND:g} K"
            )


LARGEST_LABEL = 2**31
"""Of a tissue in an image."""

Metabolic = Annotated[float, Meta(ge=0, le=1e7)]
"""[W m⁻³]"""


class Medium(Strict, frozen=True):
    """A tissue: a preset, or numbers in SI units, and its perfusion.

    Among voxels it has the `label` by which an image names it, and files may stand for
    numbers.
    """

    perfusion: Flow
    label: Annotated[int, Meta(ge=0, le=LARGEST_LABEL)] | None = None
    preset: str | None = None
    conductivity: Conductivity | str | None = None
    density: Density | str | None = None
    specific_heat: SpecificHeat | str | None = None
    metabolic: Metabolic | str | None = None

    @property
    def file(self) -> str | None:
        """One of the files that stand for numbers."""
        values = self.conductivity, self.density, self.specific_heat, self.metabolic
        files = [value for value in (*values, self.perfusion.file) if _is_file(value)]
        return str(files[0]) if files else None

    def __post_init__(self) -> None:
        for name in ("conductivity", "density", "specific_heat"):
            if self.preset is None and getattr(self, name) is None:
                raise ValueError(
                    f"expected a preset or {name}, got neither; presets are listed in "
                    "docs/thermal.md"
                )


def _is_file(value: object) -> bool:
    return isinstance(value, str)


class Power(Strict, frozen=True, tag="power", tag_field="kind"):
    """A power density [W/m³] at a reference amplitude [A/m].

    In the tumour, times `0.4 + (r/R)²` of equal power if `edge_weighted`; with a
    `width` [m] a Gaussian everywhere, about the tumour unless a `center` [m] is given.
    """

    density: PowerDensity
    reference: Reference
    width: Length | None = None
    center: tuple[Place, ...] | None = None
    edge_weighted: bool = False

    def __post_init__(self) -> None:
        if self.width is not None and self.edge_weighted:
            raise ValueError("expected a width or edge_weighted, got both; remove one")
        if self.center is not None and self.width is None:
            raise ValueError(
                "center: expected a width with it, that of a Gaussian; the power is in "
                "the tumour otherwise"
            )


class Absorption(Strict, frozen=True, tag="sar", tag_field="kind"):
    """A file of SAR [W/kg] at a reference amplitude [A/m], times a scale."""

    file: str
    reference: Reference
    scale: Scale = 1.0


class Particles(Strict, frozen=True, tag="particles", tag_field="kind"):
    """Magnetite: concentration [mg/cm³] in the tumour, or a file; diameter [nm].

    `spread` is the standard deviation of the logarithm of the diameter. The constants
    of the material are those of `LinearResponse` unless given: anisotropy [kJ/m³],
    magnetisation [kA/m], attempt time [s], coating [nm], density of the solid [kg/m³],
    and the viscosity [Pa s] of the carrier of free particles.
    """

    concentration: Concentration | str
    diameter: Annotated[float, Meta(ge=1, le=1000)]
    bound: bool = True
    spread: Annotated[float, Meta(gt=0, le=1)] | None = None
    scale: Scale = 1.0
    anisotropy: Annotated[float, Meta(ge=0.1, le=1000)] = 23.0
    magnetisation: Annotated[float, Meta(ge=1, le=2000)] = 446.0
    attempt_time: Annotated[float, Meta(ge=1e-13, le=1e-7)] = 1e-9
    coating: Annotated[float, Meta(ge=0, le=1000)] = 2.0
    solid_density: Density = 5180.0
    viscosity: Annotated[float, Meta(gt=0, le=1e6)] | None = None

    def __post_init__(self) -> None:
        if self.bound and self.viscosity is not None:
            raise ValueError(
                "viscosity: expected none for bound particles, which do not rotate; "
                "set bound = false, or remove it"
            )


class Measured(Strict, frozen=True, tag="measured", tag_field="kind"):
    """Particles with a measured table of SLP [W/g], bilinear between its entries.

    One row for each amplitude [A/m], one column for each frequency [Hz].
    """

    concentration: Concentration | str
    amplitudes: tuple[Reference, ...]
    frequencies: tuple[Frequency, ...]
    slp: tuple[tuple[Annotated[float, Meta(ge=0, le=1e5)], ...], ...]
    scale: Scale = 1.0

    def __post_init__(self) -> None:
        for name in ("amplitudes", "frequencies"):
            values = getattr(self, name)
            if not values or sorted(set(values)) != list(values):
                raise ValueError(
                    f"{name}: expected increasing numbers, got {list(values)}; sort "
                    "the table"
                )
        shape = [len(self.frequencies)] * len(self.amplitudes)
        if [len(row) for row in self.slp] != shape:
            raise ValueError(
                f"slp: expected {len(self.amplitudes)} rows, one for each amplitude, "
                f"of {len(self.frequencies)} numbers, one for each frequency, got rows "
                f"of {[len(row) for row in self.slp]}"
            )


class Eddy(Strict, frozen=True):
    """Eddy currents in tissue of a conductivity [S/m].

    The power of the `radius` [m] of the body everywhere; without one it grows with the
    distance from the axis of a cylinder or box, which is in the middle unless `axis`
    [m] says where it meets the plane of x and y.
    """

    conductivity: Annotated[float, Meta(gt=0, le=100)]
    radius: Length | None = None
    axis: tuple[Place, Place] | None = None

    def __post_init__(self) -> None:
        if self.radius is not None and self.axis is not None:
            raise ValueError("expected a radius or an axis, got both; remove one")


class Damage(Strict, frozen=True):
    """Arrhenius damage of a run: a named set, or ln A [A in 1/s] and E [J/mol]."""

    law: Literal["skin", "liver"] | None = None
    log_factor: Annotated[float, Meta(ge=0, le=1000)] | None = None
    energy: Annotated[float, Meta(ge=1e4, le=2e6)] | None = None

    def __post_init__(self) -> None:
        numbers = self.log_factor is not None, self.energy is not None
        if numbers not in ((True, True), (False, False)) or (
            (self.law is None) is not numbers[0]
        ):
            raise ValueError(
                'expected law = "skin" or "liver", or log_factor and energy; give one '
                "of the two"
            )


class Blood(Strict, frozen=True):
    """Blood: density [kg/m³], specific heat [J/kg/K], arterial temperature [°C]."""

    density: Density = 1050.0
    specific_heat: SpecificHeat = 3617.0
    arterial: Arterial = 37.0


Heating = Power | Absorption | Particles | Measured


def heating_file(heating: Heating) -> str | None:
    """The file that says where heat is, if there is one."""
    if isinstance(heating, Absorption):
        return heating.file
    if isinstance(heating, Power):
        return None
    return heating.concentration if isinstance(heating.concentration, str) else None


LimitName = Literal["atkinson-brezovich", "hergt-dutz"]
