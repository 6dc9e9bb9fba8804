r"""Exact rises of Gaussian spots, and of any field in a periodic box.

References:
    Gao, Langer and Corry, Int. J. Hyperthermia 11, 267 (1995), the periodic box.
"""

import numpy as np
import scipy.integrate
from jaxtyping import Float
from validation.heat.exact.media import Medium, Number


def gaussian_source(
    r: Number, t: Number, medium: Medium, source: Number, width: Number, dim: int
) -> float:
    r"""Rise from zero under a constant source $Q e^{-r^2/2\sigma^2}$.

    The integral over time of the decay of $\theta_0 = Q/\rho c$ in an infinite space,
    $\theta_0 v(t)^{d/2} e^{-r^2/2(\sigma^2+2\alpha t) - pt}$,
    $v(t) = \sigma^2/(\sigma^2+2\alpha t)$.

    Args:
        r: distance from the centre [m].
        t: time [s].
        medium: with or without perfusion.
        source: $Q$ at the centre [W m⁻³].
        width: $\sigma$ [m].
        dim: 1, 2 or 3.
    """
    rate = source / medium.capacity

    def decay(s: float) -> float:
        spread = width**2 + 2 * medium.diffusivity * s
        fading = np.exp(-(r**2) / (2 * spread) - medium.rate * s)
        return float(rate * (width**2 / spread) ** (dim / 2) * fading)

    value, _ = scipy.integrate.quad(
        decay,
        0.0,
        t,
        epsabs=1e-13,
        epsrel=1e-13,
        limit=400,
    )
    return value


def periodic_box(
    rise: Float[np.ndarray, "..."],
    source: Float[np.ndarray, "..."],
    t: Number,
    medium: Medium,
    spacing: Number,
) -> Float[np.ndarray, "..."]:
    r"""Rise after $t$ in a periodic box, exact for what its grid resolves.

    $F^{-1}\{e^{-gt} F(\theta_0) + \frac{1 - e^{-gt}}{g} F(Q/\rho c)\}$,
    $g = \alpha K^2 + p$; the limit is $t$ where $g = 0$.

    Args:
        rise: $\theta_0$ [K] on a grid of any dimension.
        source: $Q$ [W m⁻³] there.
        t: time [s].
        medium: with or without perfusion.
        spacing: of the grid [m].
    """
    waves = [2 * np.pi * np.fft.fftfreq(n, spacing) for n in rise.shape]
    squares = sum(wave**2 for wave in np.meshgrid(*waves, indexing="ij"))
    decay = medium.diffusivity * np.asarray(squares) + medium.rate
    still = decay == 0
    safe = np.where(still, 1.0, decay)
    response = np.where(still, t, -np.expm1(-decay * t) / safe)
    result = np.exp(-decay * t) * np.fft.fftn(rise)
    result = result + response * np.fft.fftn(source / medium.capacity)
    return np.fft.ifftn(result).real
