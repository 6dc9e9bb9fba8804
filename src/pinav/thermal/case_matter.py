"""Tables of a case that say what tissues are, what heats them, and how in time."""

import itertools
from collections.abc import Mapping
from typing import Annotated, Literal

import jax.numpy as jnp
import msgspec
import numpy as np
from msgspec import Meta

from pinav.thermal import quantities, sources
from pinav.thermal.perfusion import (
    AbstractPerfusion,
    ConstantPerfusion,
    TabulatedPerfusion,
    lang,
    mass_perfusion,
)
from pinav.thermal.protocols import Piecewise
from pinav.thermal.quantities import Strict
from pinav.thermal.tissues import Blood, Tissue, preset

PROPERTIES = ("conductivity", "density", "specific_heat", "metabolic")
"""Passive properties that a tissue states, or takes from its preset."""


class Flow(Strict, frozen=True):
    """A perfusion: a number with its unit, or a law of Lang et al. by its tissue.

    Among voxels a `file` in a unit, too; or a law of one's own, `values` in a unit at
    `temperatures` [°C], linear between them.
    """

    law_name: str | None = msgspec.field(default=None, name="law")
    value: quantities.Magnitude | None = None
    temperatures: tuple[quantities.Celsius, ...] = ()
    values: tuple[quantities.Magnitude, ...] = ()
    file: str | None = None
    unit: str | None = None

    def __post_init__(self) -> None:
        given = [one is not None for one in (self.law_name, self.value, self.file)]
        given.append(bool(self.values))
        if sum(given) != 1 or (self.law_name is None) is (self.unit is None):
            raise ValueError(
                "expected a law, or a value with its unit, such as "
                '{value = 6.7e-4, unit = "1/s"}'
            )
        if self.values or self.temperatures:  # refuses a law that jumps
            TabulatedPerfusion(self.temperatures, jnp.asarray(self.values, float))

    def law(self, blood: Blood, tissue: Tissue) -> AbstractPerfusion:
        """The perfusion that is stated, but for that of a file."""
        if self.law_name is not None:
            return lang(self.law_name)
        assert self.unit is not None
        masses = [
            mass_perfusion(value, unit=self.unit, blood=blood, tissue=tissue)
            for value in self.values or (self.value,)
            if value is not None
        ]
        if self.values:
            return TabulatedPerfusion(self.temperatures, jnp.asarray(masses))
        return ConstantPerfusion(masses[0])


LARGEST_LABEL = 2**31
"""Largest label of a tissue in an image."""


class Medium(Strict, frozen=True):
    """A tissue: a preset, or numbers in SI units, and its perfusion.

    Among voxels it has the `label` by which an image names it, and files may stand for
    numbers.
    """

    perfusion: Flow
    label: Annotated[int, Meta(ge=0, le=LARGEST_LABEL)] | None = None
    preset: str | None = None
    conductivity: quantities.Conductivity | str | None = None
    density: quantities.Density | str | None = None
    specific_heat: quantities.SpecificHeat | str | None = None
    metabolic: quantities.Metabolic | str | None = None

    @property
    def file(self) -> str | None:
        """One of the files that stand for numbers."""
        values = self.conductivity, self.density, self.specific_heat, self.metabolic
        files = [one for one in (*values, self.perfusion.file) if isinstance(one, str)]
        return files[0] if files else None

    def properties(self, maps: Mapping[str, np.ndarray] | None = None) -> Tissue:
        """Passive properties: its own numbers, those of its preset, or of maps.

        Args:
            maps: values for each cell, of the properties that a file states.
        """
        base = None if self.preset is None else preset(self.preset).tissue
        values = {}
        for name in PROPERTIES:
            value = getattr(self, name)
            inherited = 0.0 if base is None else getattr(base, name)
            values[name] = inherited if value is None else value
        for name, numbers in (maps or {}).items():
            values[name] = jnp.asarray(numbers)
        return Tissue(**values)

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
    `width` [m] a Gaussian everywhere, about the tumour unless a `center` [m] is given.
    """

    density: quantities.PowerDensity
    reference: quantities.Reference
    width: quantities.Length | None = None
    center: tuple[quantities.Place, ...] | None = None
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
    reference: quantities.Reference
    scale: quantities.Scale = 1.0


class Particles(Strict, frozen=True, tag="particles", tag_field="kind"):
    """Magnetite: concentration [mg/cm³] in the tumour, or a file; diameter [nm].

    `spread` is the standard deviation of the logarithm of the diameter. The constants
    of the material are those of `LinearResponse` unless given: anisotropy [kJ/m³],
    magnetisation [kA/m], attempt time [s], coating [nm], density of the solid [kg/m³],
    and the viscosity [Pa s] of the carrier of free particles.
    """

    concentration: quantities.Concentration | str
    diameter: Annotated[float, Meta(ge=1, le=1000)]
    bound: bool = True
    spread: Annotated[float, Meta(gt=0, le=1)] | None = None
    scale: quantities.Scale = 1.0
    anisotropy: Annotated[float, Meta(ge=0.1, le=1000)] = 23.0
    magnetisation: Annotated[float, Meta(ge=1, le=2000)] = 446.0
    attempt_time: Annotated[float, Meta(ge=1e-13, le=1e-7)] = 1e-9
    coating: Annotated[float, Meta(ge=0, le=1000)] = 2.0
    solid_density: quantities.Density = 5180.0
    viscosity: Annotated[float, Meta(gt=0, le=1e6)] | None = None

    def __post_init__(self) -> None:
        if self.bound and self.viscosity is not None:
            raise ValueError(
                "viscosity: expected none for bound particles, which do not rotate; "
                "set bound = false, or remove it"
            )

    def heating(self) -> sources.AbstractHeating:
        viscosity = 1e-3 if self.viscosity is None else self.viscosity
        response = sources.LinearResponse(
            1e-9 * self.diameter,
            anisotropy=1e3 * self.anisotropy,
            magnetisation=1e3 * self.magnetisation,
            attempt_time=self.attempt_time,
            viscosity=float("inf") if self.bound else viscosity,
            coating=1e-9 * self.coating,
            density=self.solid_density,
        )
        if self.spread is None:
            return response
        return sources.LogNormalSizes(response, self.spread)


class Measured(Strict, frozen=True, tag="measured", tag_field="kind"):
    """Particles with a measured table of SLP [W/g], bilinear between its entries.

    One row for each amplitude [A/m], one column for each frequency [Hz].
    """

    concentration: quantities.Concentration | str
    amplitudes: tuple[quantities.Reference, ...]
    frequencies: tuple[quantities.Frequency, ...]
    slp: tuple[tuple[Annotated[float, Meta(ge=0, le=1e5)], ...], ...]
    scale: quantities.Scale = 1.0

    def __post_init__(self) -> None:
        sources.check_increasing(self, "amplitudes", "frequencies")
        shape = [len(self.frequencies)] * len(self.amplitudes)
        if [len(row) for row in self.slp] != shape:
            raise ValueError(
                f"slp: expected {len(self.amplitudes)} rows, one for each amplitude, "
                f"of {len(self.frequencies)} numbers, one for each frequency, got rows "
                f"of {[len(row) for row in self.slp]}"
            )

    def heating(self) -> sources.AbstractHeating:
        return sources.TabulatedHeating(
            np.array(self.amplitudes),
            np.array(self.frequencies),
            1e3 * np.array(self.slp),
        )


Heating = Power | Absorption | Particles | Measured


def heating_file(heating: Heating) -> str | None:
    """The file that says where heat is, if there is one."""
    if isinstance(heating, Absorption):
        return heating.file
    if isinstance(heating, Power):
        return None
    return heating.concentration if isinstance(heating.concentration, str) else None


LimitName = Literal["atkinson-brezovich", "hergt-dutz"]


MOST_INTERVALS = 10_000
"""Intervals of constant amplitude; each costs a step or more."""


class FieldTable(Strict, frozen=True):
    """Amplitudes [A/m] in intervals between times [s], at a frequency [Hz].

    In place of the amplitudes, `ramp` gives one at each time, linear between them; `on`
    and `off` [s] make bursts of the one amplitude until the last time.
    """

    frequency: quantities.Frequency
    times: tuple[Annotated[float, Meta(ge=0, le=1e7)], ...]
    amplitudes: tuple[quantities.Amplitude, ...] = ()
    ramp: tuple[quantities.Amplitude, ...] = ()
    on: quantities.Time | None = None
    off: quantities.Time | None = None

    def __post_init__(self) -> None:
        self._check_times()
        if (self.on is None) != (self.off is None):
            raise ValueError(
                "expected on and off together, got one of them; give the other"
            )
        if (count := self._intervals) > MOST_INTERVALS:
            raise ValueError(
                f"expected at most {MOST_INTERVALS:,} intervals, got {count:,.0f}; "
                "take longer bursts, or a lower constant amplitude of the same power"
            )
        if self.ramp:
            self._check_ramp()
            return
        if self.on is not None:
            self._check_bursts(self.on)
        count = 1 if self.on is not None else len(self.times) - 1
        if len(self.amplitudes) != count:
            raise ValueError(
                f"amplitudes: expected {count}, one for each interval between two "
                f"times, or one for bursts; got {len(self.amplitudes)}"
            )

    def _check_bursts(self, on: float) -> None:
        if len(self.times) != 2:
            raise ValueError(
                f"times: expected 0 and the end of the bursts, got {list(self.times)}; "
                "remove the others"
            )
        if on >= self.duration:
            raise ValueError(
                f"on: expected a burst within the protocol, < {self.duration:g} s, got "
                f"{on:g} s; shorten it, or remove on and off"
            )

    def _check_ramp(self) -> None:
        if self.amplitudes or self.on is not None:
            raise ValueError(
                "ramp: expected no amplitudes and no bursts with it; remove them"
            )
        if len(self.ramp) != len(self.times):
            raise ValueError(
                f"ramp: expected {len(self.times)} amplitudes, one at each time, got "
                f"{len(self.ramp)}"
            )

    def _check_times(self) -> None:
        if len(self.times) < 2 or self.times[0] != 0:
            raise ValueError(
                f"times: expected 0 and one later time or more, got {list(self.times)}"
            )
        gaps = [b - a for a, b in itertools.pairwise(self.times)]
        if min(gaps) <= 1e-6 * self.times[-1]:
            raise ValueError(
                "times: expected increasing times, a millionth of the last apart or "
                f"more, got {list(self.times)}; write each once, in order"
            )

    def build(self) -> Piecewise:
        if self.ramp:
            return Piecewise.ramp(self.times, self.ramp, self.frequency)
        if self.on is None or self.off is None:
            return Piecewise.constant(self.times, self.amplitudes, self.frequency)
        return Piecewise.on_off(
            self.amplitudes[0],
            self.frequency,
            on=self.on,
            off=self.off,
            duration=self.duration,
        )

    @property
    def duration(self) -> float:
        return self.times[-1]

    @property
    def _intervals(self) -> float | int:
        if self.on is None or self.off is None:
            return len(self.times) - 1
        return 2 * self.duration / (self.on + self.off)
