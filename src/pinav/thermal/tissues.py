r"""Tissue and blood: properties, named presets with their sources, and mixtures.

A factor of two between sources is normal, and up to ten for perfusion: presets are for
examples, not for anybody's body.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.quantities import Arterial, Density, Field, SpecificHeat

Property = Scalar | Field
"""The same everywhere, or one value for each cell."""


def check_positive(name: str, value: Any, unit: str) -> None:
    """Refuse a number or array, where it is known, that is not positive."""
    least = least_known(value)
    if least is not None and not least > 0:
        raise InputError(f"{name}: expected > 0 {unit}, got {least:g}")


def least_known(value: Any) -> float | None:
    """The smallest entry; None where it is traced."""
    if isinstance(value, float | int | np.ndarray):
        return float(np.min(value))
    if isinstance(value, jax.Array) and not isinstance(value, Tracer):
        return float(jnp.min(value))
    return None


class Tissue(eqx.Module):
    """Passive properties of tissue.

    Attributes:
        conductivity: $k$ [W m⁻¹ K⁻¹], positive.
        density: of the tissue [kg m⁻³], positive.
        specific_heat: $c$ [J kg⁻¹ K⁻¹], positive.
        metabolic: $Q_{met}$ [W m⁻³], not negative.

    Raises:
        InputError: a number has the wrong sign.
    """

    conductivity: Property
    density: Property
    specific_heat: Property
    metabolic: Property = 0.0

    def __check_init__(self) -> None:
        for name in ("conductivity", "density", "specific_heat"):
            check_positive(f"Tissue.{name}", getattr(self, name), _UNITS[name])
        least = least_known(self.metabolic)
        if least is not None and least < 0:
            raise InputError(
                f"Tissue.metabolic: expected >= 0 W/m³, got {least:g}; heat that is "
                "taken away belongs to a boundary or to perfusion"
            )

    @property
    def capacity(self) -> Property:
        r"""Heat capacity per volume, $\rho c$ [J m⁻³ K⁻¹]."""
        return self.density * self.specific_heat


_UNITS = {"conductivity": "W/(m K)", "density": "kg/m³", "specific_heat": "J/(kg K)"}


class Blood(eqx.Module):
    """Blood that perfuses the tissue.

    Attributes:
        specific_heat: $c_b$ [J kg⁻¹ K⁻¹], positive.
        arterial: $T_a$ [°C].

    Raises:
        InputError: a number has the wrong sign.
    """

    density: Scalar = eqx.field(default=1050.0, metadata={"range": Density})
    specific_heat: Scalar = eqx.field(default=3617.0, metadata={"range": SpecificHeat})
    arterial: Scalar = eqx.field(default=37.0, metadata={"range": Arterial})

    def __check_init__(self) -> None:
        for name in ("density", "specific_heat"):
            check_positive(f"Blood.{name}", getattr(self, name), _UNITS[name])


class Preset(eqx.Module):
    """A tissue under a name, with where its numbers come from.

    Attributes:
        perfusion: at rest, volume of blood per volume of tissue [s⁻¹].
    """

    tissue: Tissue
    perfusion: float
    source: str = eqx.field(static=True)


PRESETS = {
    "muscle": Preset(
        Tissue(0.49, 1090.0, 3421.0, 700.0),
        6.7e-4,
        "values like those of the IT'IS database; not checked against a release",
    ),
    "liver": Preset(
        Tissue(0.52, 1079.0, 3540.0, 1e4),
        0.01,
        "k-Wave unit tests (conductivity, density, specific heat, perfusion); "
        "metabolic heat of order 1e4 W/m³, unchecked",
    ),
    "fat": Preset(
        Tissue(0.21, 911.0, 2348.0, 400.0),
        4e-4,
        "values like those of the IT'IS database; not checked against a release",
    ),
    "skin": Preset(
        Tissue(0.37, 1109.0, 3391.0, 1830.0),
        1.96e-3,
        "published optimisation code fmincon_Entropy_arbitraryFunction",
    ),
    "tumour": Preset(
        Tissue(0.55, 1045.0, 3600.0, 5000.0),
        8.33e-4,
        "generic; perfusion as in fhdFoam; real tumours differ by a factor of ten",
    ),
}


def preset(name: str) -> Preset:
    """A tissue by its name."""
    if name not in PRESETS:
        raise InputError(
            f"tissue preset {name!r} is unknown; choose one of: {', '.join(PRESETS)}"
        )
    return PRESETS[name]


def mix(fractions: Sequence[Field], tissues: Sequence[Tissue]) -> Tissue:
    r"""Tissues in the cells that they share, by their volume fractions.

    $1/k$, $\rho$, $\rho c$ and $Q_{met}$ are averaged by volume: heat that crosses a
    cut cell meets all tissues in series.
    """

    def average(quantity: Callable[[Tissue], Any]) -> Any:
        pairs = zip(fractions, tissues, strict=True)
        return sum(fraction * quantity(tissue) for fraction, tissue in pairs)

    density = average(lambda tissue: tissue.density)
    # Density comes first: the specific heat is the ratio that keeps the capacity exact.
    return Tissue(
        conductivity=1 / average(lambda tissue: 1 / tissue.conductivity),
        density=density,
        specific_heat=average(lambda tissue: tissue.capacity) / density,
        metabolic=average(lambda tissue: tissue.metabolic),
    )
