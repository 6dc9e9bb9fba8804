"""The library of candidate laws: forces without a potential."""

import dataclasses
from typing import final

from pinav.analysis.discovery.functions import Expr, Functions
from pinav.analysis.discovery.geometries import CENTER, Center, Line, ProfileLaw
from pinav.analysis.discovery.laws import (
    AbstractLaw,
    AbstractRotation,
    Constant,
    Constants,
    Landscape,
    Role,
    Turned,
)
from pinav.analysis.discovery.potentials import (
    GAUSSIAN,
    PLANE_WAVE,
    POTENTIALS,
    WALL,
    profile_laws,
)
from pinav.analysis.discovery.profiles import Harmonic


@final
@dataclasses.dataclass(frozen=True)
class SolidRotation(AbstractRotation):
    r"""$\psi = -\tfrac12 \Omega r^2$: $\Omega\,(-(y - c_y),\ x - c_x)$."""

    name = "solid rotation"
    constants = (Constant("rate", r"\Omega", Role.AMPLITUDE, "T⁻²"), *CENTER)

    def stream(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
        return -c[0] * ((x - c[1]) ** 2 + (y - c[2]) ** 2) / 2

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        return [(1.0, *center) for center in landscape.centers]


SOLID_ROTATION = SolidRotation()
GAUSSIAN_SWIRL = Turned(GAUSSIAN, "Gaussian swirl")
SHEAR = Turned(ProfileLaw(Harmonic(), Line()), "shear")

SWIRLS: tuple[AbstractRotation, ...] = (
    SOLID_ROTATION,
    *(
        Turned(law, f"{law.name} swirl")
        for law in profile_laws(Center())
        if law.name != Harmonic.name
    ),
)
"""Swirls about a centre."""

SHEAR_LAYERS: tuple[AbstractRotation, ...] = (
    SHEAR,
    *(
        Turned(law, f"shear, {law.name}")
        for law in (*profile_laws(Line()), WALL, PLANE_WAVE)
        if law != SHEAR.law
    ),
)
"""Forces along the layers of a line."""

ROTATIONS: tuple[AbstractRotation, ...] = (GAUSSIAN_SWIRL, SOLID_ROTATION, SHEAR)
"""Candidates without a potential of a force of unknown structure."""

LIBRARY: tuple[AbstractLaw, ...] = (*POTENTIALS, *ROTATIONS)
"""Candidates of a force of unknown structure."""
