"""The numbers that a case of `pinav heat` may hold, and what to do about others."""

from typing import Annotated

import msgspec
from msgspec import Meta

Length = Annotated[float, Meta(gt=0, le=10)]
"""[m]"""
Edge = Annotated[float, Meta(ge=1e-5, le=0.05)]
"""[m], of a voxel; the bounds refuse millimetres."""
Place = Annotated[float, Meta(ge=-10, le=10)]
"""[m]"""
Time = Annotated[float, Meta(gt=0, le=1e7)]
"""[s]"""
Celsius = Annotated[float, Meta(ge=-50, le=100)]
"""[°C]; the bounds refuse kelvins."""
Arterial = Annotated[float, Meta(ge=10, le=45)]
"""[°C]"""
Amplitude = Annotated[float, Meta(ge=0, le=1e6)]
"""[A m⁻¹]; 1e6 are 1.3 T."""
Reference = Annotated[float, Meta(gt=0, le=1e6)]
"""[A m⁻¹]"""
Frequency = Annotated[float, Meta(ge=1e3, le=1e9)]
"""[Hz]; the bounds refuse kilohertz."""
Positive = Annotated[float, Meta(gt=0, le=1e15)]
Magnitude = Annotated[float, Meta(ge=0, le=1e15)]
PowerDensity = Annotated[float, Meta(ge=0, le=1e10)]
"""[W m⁻³]"""
Conductivity = Annotated[float, Meta(gt=0, le=1000)]
"""[W m⁻¹ K⁻¹]"""
Density = Annotated[float, Meta(ge=50, le=30_000)]
"""[kg m⁻³]; the bounds refuse grams per cubic centimetre."""
SpecificHeat = Annotated[float, Meta(ge=10, le=50_000)]
"""[J kg⁻¹ K⁻¹]; the bounds refuse kilojoules."""
Concentration = Annotated[float, Meta(ge=0, le=5180)]
"""[mg cm⁻³]; solid magnetite has 5180."""
Scale = Annotated[float, Meta(ge=0, le=100)]
Fraction = Annotated[float, Meta(gt=0, le=1)]
NOISIEST = 100.0
"""Standard deviation [K] of a reading."""
Noise = Annotated[float, Meta(ge=0, le=NOISIEST)]
"""[K]"""
Seed = Annotated[int, Meta(ge=0, le=2**32 - 1)]
Cells = Annotated[int, Meta(ge=3, le=100_000)]


class Strict(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A table in which an unknown key is a mistake."""


ADVICE = {
    "absorption": "give W/kg",
    "perfusion": "give a perfusion in its unit",
    "after": "give seconds",
    "coefficient": "give the change of the shift per kelvin, about -1e-8",
    "echo": "give seconds",
    "magnet": "give tesla",
    "turn": "give the temperature in kelvin that a turn of the phase is",
    "until": "give seconds",
    "ambient": "give it in °C, which is kelvins less 273.15",
    "amplitudes": "give A/m; 1 mT are 796 A/m",
    "axis": "give metres",
    "anisotropy": "give kJ/m³",
    "arterial": "give it in °C, which is kelvins less 273.15",
    "cells": "give the number of cells along each axis",
    "center": "give metres",
    "coating": "give nanometres",
    "concentration": "give mg/cm³, the same as kg/m³",
    "conductivity": "give W/(m K), or S/m of eddy currents",
    "energy": "give J/mol",
    "log_factor": "give the natural logarithm of the factor in 1/s",
    "density": "give kg/m³ of a tissue, W/m³ of a power",
    "attempt_time": "give seconds",
    "diameter": "give nanometres",
    "every": "give seconds",
    "exchange": "give W/(m² K)",
    "frequencies": "give hertz",
    "frequency": "give hertz",
    "healthy_dose": "give CEM43 minutes",
    "held_out": "give powers relative to that of the fit",
    "largest": "give A/m; 1 mT are 796 A/m",
    "magnetisation": "give kA/m",
    "margin": "give metres",
    "max_temperature": "give it in °C, which is kelvins less 273.15",
    "metabolic": "give W/m³",
    "noise": "give the standard deviation of a reading in kelvin",
    "off": "give seconds",
    "on": "give seconds",
    "points": "give metres",
    "radius": "give metres",
    "ramp": "give A/m; 1 mT are 796 A/m",
    "reference": "give A/m; 1 mT are 796 A/m",
    "slp": "give W/g",
    "solid_density": "give kg/m³",
    "size": "give metres",
    "specific_heat": "give J/(kg K)",
    "spread": "give the standard deviation of the logarithm of the diameter",
    "start": "give a fraction of the largest amplitude",
    "step": "give seconds",
    "temperature": "give it in °C, which is kelvins less 273.15",
    "times": "give seconds",
    "value": "give a perfusion in its unit",
    "viscosity": "give Pa s",
    "width": "give metres",
}
"""What a number under a key is; keys of the same name are of the same kind."""
