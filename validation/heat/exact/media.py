r"""The uniform medium in which the exact solutions live."""

import dataclasses
import math

from pinav.thermal.quantities import Number


@dataclasses.dataclass(frozen=True)
class Medium:
    r"""Tissue with constant properties, perfused by blood of arterial temperature.

    Attributes:
        conductivity: $k$ [W m⁻¹ K⁻¹].
        capacity: $\rho c$ [J m⁻³ K⁻¹].
        perfusion: $W = \rho_b c_b \omega_b$ [W m⁻³ K⁻¹]; zero without blood.
    """

    conductivity: Number
    capacity: Number
    perfusion: Number = 0.0

    @property
    def diffusivity(self) -> float:
        r"""$\alpha = k/(\rho c)$ [m² s⁻¹]."""
        return self.conductivity / self.capacity

    @property
    def rate(self) -> float:
        r"""$p = W/(\rho c)$ [s⁻¹]."""
        return self.perfusion / self.capacity

    @property
    def inverse_length(self) -> float:
        r"""$m = \sqrt{W/k}$ [m⁻¹]."""
        return math.sqrt(self.perfusion / self.conductivity)


SET_S = Medium(conductivity=0.5, capacity=1050.0 * 3600.0, perfusion=1050.0 * 3.617)
r"""The reference medium: $\rho_b c_b \omega_b$ with 1050 kg m⁻³, 3617 J kg⁻¹ K⁻¹ and
10⁻³ s⁻¹."""
