"""Limits of the field that a body is exposed to: objects of their own, with names.

Which limit holds is the user's choice. A product of amplitude and frequency leaves out
the duty cycle; what limits in practice is the temperature that eddy currents make.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.protocols import Piecewise
from pinav.thermal.quantities import Number
from pinav.thermal.sources import ParticleSource


class HfLimit(eqx.Module):
    """A bound on the product of amplitude and frequency.

    Attributes:
        product: largest $Hf$ [A m⁻¹ s⁻¹], positive.
    """

    product: Number
    name: str = eqx.field(static=True, default="Hf limit")

    def __check_init__(self) -> None:
        if not self.product > 0:
            raise InputError(
                f"HfLimit.product: expected > 0 A/(m s), got {self.product}"
            )

    def exposure(self, protocol: Piecewise) -> Float[Array, " interval"]:
        """$Hf$ of each interval, differentiable by the amplitudes.

        The largest of them has a kink, at which an optimiser stops.
        """
        return jnp.maximum(protocol.starts, protocol.ends) * protocol.frequency


ATKINSON_BREZOVICH = HfLimit(product=4.85e8, name="Atkinson-Brezovich limit")
"""Tolerated for over an hour by a torso of some 30 cm: Atkinson, Brezovich and
Chakraborty, IEEE Trans. Biomed. Eng. 31, 70 (1984)."""

HERGT_DUTZ = HfLimit(product=5e9, name="Hergt-Dutz limit")
"""Proposed for smaller exposed regions: Hergt and Dutz, J. Magn. Magn. Mater. 311, 187
(2007)."""

LIMITS = {"atkinson-brezovich": ATKINSON_BREZOVICH, "hergt-dutz": HERGT_DUTZ}


def require(protocol: Piecewise, *limits: HfLimit) -> None:
    """Refuse a protocol that exceeds a limit."""
    for limit in limits:
        reached = float(jnp.max(limit.exposure(protocol)))
        if reached > limit.product * (1 + 1e-9):
            raise InputError(
                f"protocol exceeds the {limit.name}: expected <= {limit.product:.4g} "
                f"A/(m s), got {reached:.4g} A/(m s); lower the amplitude or "
                "the frequency, or choose another limit"
            )


def limit(name: str) -> HfLimit:
    """A limit of the product $Hf$ by its name."""
    if name not in LIMITS:
        raise InputError(
            f"field limit {name!r} is unknown; choose one of: {', '.join(LIMITS)}"
        )
    return LIMITS[name]


def validity_warnings(
    model: Bioheat, protocol: Piecewise, hottest: Scalar | None = None
) -> list[str]:
    """What of a run lies outside the range of its laws, one sentence each."""
    warnings = []
    for source in model.sources:
        if isinstance(source, ParticleSource):
            strain = float(source.heating.validity(protocol.largest))
            if strain > 1:
                warnings.append(
                    f"{type(source.heating).__name__} is strained {strain:.3g} times "
                    "beyond its range of validity (1) at the largest amplitude; the "
                    "power is doubtful"
                )
    if hottest is not None and float(hottest) > HOTTEST_VALID:
        warnings.append(
            f"{float(hottest):.1f} °C is reached; perfusion and heating laws hold up "
            f"to about {HOTTEST_VALID:g} °C"
        )
    return warnings


HOTTEST_VALID = 55.0
"""Temperature [°C] above which neither perfusion nor linear response is known."""
