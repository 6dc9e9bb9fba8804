"""What a case of `pinav heat` is made of: tissues, and what heats them."""

from typing import Annotated, Literal

from msgspec import Meta

from pinav.commands.heat.bounds import (
    Concentration,
    Conductivity,
    Density,
    Length,
    Magnitude,
    PowerDensity,
    Reference,
    SpecificHeat,
    Strict,
)


class Flow(Strict, frozen=True):
    """A perfusion: a number with its unit, or a law of Lang et al. by its tissue."""

    law: str | None = None
    value: Magnitude | None = None
    unit: str | None = None

    def __post_init__(self) -> None:
        number = self.value is not None, self.unit is not None
        if number not in ((False, False), (True, True)) or (
            (self.law is None) is not number[0]
        ):
            raise ValueError(
                "expected a law, or a value with its unit, such as "
                '{value = 6.7e-4, unit = "1/s"}'
            )


class Medium(Strict, frozen=True):
    """A tissue: a preset, or numbers in SI units, and its perfusion."""

    perfusion: Flow
    preset: str | None = None
    conductivity: Conductivity | None = None
    density: Density | None = None
    specific_heat: SpecificHeat | None = None
    metabolic: Annotated[float, Meta(ge=0, le=1e7)] | None = None

    def __post_init__(self) -> None:
        for name in ("conductivity", "density", "specific_heat"):
            if self.preset is None and getattr(self, name) is None:
                raise ValueError(
                    f"expected a preset or {name}, got neither; presets are listed in "
                    "docs/thermal.md"
                )


class Power(Strict, frozen=True, tag="power", tag_field="kind"):
    """A power density [W/m³] at a reference amplitude [A/m].

    In the tumour, times `0.4 + (r/R)²` of equal power if `edge_weighted`; with a
    `width` [m] a Gaussian everywhere.
    """

    density: PowerDensity
    reference: Reference
    width: Length | None = None
    edge_weighted: bool = False

    def __post_init__(self) -> None:
        if self.width is not None and self.edge_weighted:
            raise ValueError("expected a width or edge_weighted, got both; remove one")


class Particles(Strict, frozen=True, tag="particles", tag_field="kind"):
    """Magnetite in the tumour: concentration [mg/cm³], diameter [nm].

    `spread` is the standard deviation of the logarithm of the diameter.
    """

    concentration: Concentration
    diameter: Annotated[float, Meta(ge=1, le=1000)]
    bound: bool = True
    spread: Annotated[float, Meta(gt=0, le=1)] | None = None
    scale: Annotated[float, Meta(ge=0, le=100)] = 1.0


class Eddy(Strict, frozen=True):
    """Eddy currents: radius of the body [m], conductivity [S/m]."""

    radius: Length
    conductivity: Annotated[float, Meta(gt=0, le=100)]


LimitName = Literal["atkinson-brezovich", "hergt-dutz"]
