r"""Exact rises in slabs, and in cylinders and spheres held at the arterial temperature.

All functions return the rise $\theta = T - T_a$ [K] unless they say otherwise.
"""

from typing import Any

import numpy as np
import scipy.special
from jaxtyping import Float
from validation.heat.exact.media import Medium, Number

MODES = 400
"""Terms of a series; those beyond have decayed within a thousandth of a second."""

Points = Float[np.ndarray, " point"]


def perfused_slab(
    x: Points, t: Number, medium: Medium, source: Number, length: Number
) -> Points:
    r"""Uniform source, insulated at 0, at the arterial temperature at $L$ and at first.

    $\theta = \frac{Q}{W}\left(1 - \frac{\cosh mx}{\cosh mL}\right)
    - \sum_n \frac{2Q}{\rho c L} \frac{(-1)^n}{b_n} \cos(b_n x)
    \frac{e^{-\lambda_n t}}{\lambda_n}$, $b_n = (n + \tfrac12)\pi/L$,
    $\lambda_n = \alpha b_n^2 + p$.

    Args:
        x: places [m].
        t: time [s]; infinity for the steady state.
        medium: with perfusion.
        source: $Q$ [W m⁻³].
        length: $L$ [m].
    """
    m = medium.inverse_length
    steady = source / medium.perfusion * (1 - np.cosh(m * x) / np.cosh(m * length))
    # The steady part in closed form: the series of it alone converges slowly.
    if np.isinf(t):
        return steady
    n = np.arange(MODES)
    b = (n + 0.5) * np.pi / length
    decay = medium.diffusivity * b**2 + medium.rate
    size = (-1.0) ** n / b * np.exp(-decay * t) / decay
    sums = np.cos(b * np.asarray(x)[:, None]) @ size
    return steady - 2 * source / (medium.capacity * length) * sums


def perfused_cylinder(
    r: Points, medium: Medium, source: Number, radius: Number
) -> Points:
    r"""Steady, uniform source: $\frac{Q}{W}(1 - I_0(mr)/I_0(mR))$."""
    m = medium.inverse_length
    ratio = scipy.special.iv(0, m * r) / scipy.special.iv(0, m * radius)
    return source / medium.perfusion * (1 - ratio)


def perfused_ball(r: Points, medium: Medium, source: Number, radius: Number) -> Points:
    r"""Steady, uniform source: $\frac{Q}{W}(1 - \frac{R \sinh mr}{r \sinh mR})$."""
    m = medium.inverse_length
    ratio = _sinhc(m * np.asarray(r)) / _sinhc(np.asarray(m * radius))
    return source / medium.perfusion * (1 - ratio)


def skin(
    x: Points,
    medium: Medium,
    metabolic: Number,
    length: Number,
    exchange: Number,
    ambient: Number,
    *,
    arterial: Number = 37.0,
    core: Number = 37.0,
) -> Points:
    r"""Steady temperature [°C] below a surface that loses heat to the air.

    $T = T_s + A \cosh mx + B \sinh mx$ with $T_s = T_a + Q_{met}/W$,
    $k T'(0) = h (T(0) - T_\infty)$ and $T(L)$ the core's temperature.

    Args:
        x: depths [m].
        medium: with perfusion.
        metabolic: $Q_{met}$ [W m⁻³].
        length: $L$ [m].
        exchange: $h$ [W m⁻² K⁻¹].
        ambient: $T_\infty$ [°C].
        arterial: $T_a$ [°C].
        core: temperature at $L$ [°C].
    """
    m, k = medium.inverse_length, medium.conductivity
    far = arterial + metabolic / medium.perfusion
    rows = [[-exchange, k * m], [np.cosh(m * length), np.sinh(m * length)]]
    right = [exchange * (far - ambient), core - far]
    a, b = np.linalg.solve(np.array(rows), np.array(right))
    return far + a * np.cosh(m * x) + b * np.sinh(m * x)


def _sinhc(x: Any) -> Any:
    """Sinh(x)/x, one at zero."""
    small = np.abs(x) < 1e-8
    safe = np.where(small, 1.0, x)
    return np.where(small, 1.0, np.sinh(safe) / safe)
