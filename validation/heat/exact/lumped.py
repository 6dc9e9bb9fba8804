r"""Exact answers without space: lumped tissue, doses of ramps, optimal controls."""

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.integrate
import scipy.optimize
from validation.heat.exact.media import Medium, Number


def lumped_rise(t: Number, medium: Medium, source: Number) -> float:
    r"""$\theta = \frac{Q}{W}(1 - e^{-pt})$ [K]."""
    return float(-source / medium.perfusion * np.expm1(-medium.rate * t))


def lumped_forced(t: Number, medium: Medium, source: Number, period: Number) -> float:
    r"""Rise under $Q \sin^2(\pi t/P)$.

    $\frac{A}{2}\left[\frac{1-e^{-pt}}{p} - \frac{p\cos\Omega t + \Omega\sin\Omega t -
    p e^{-pt}}{p^2+\Omega^2}\right]$, $A = Q/\rho c$, $\Omega = 2\pi/P$.
    """
    p, omega = medium.rate, 2 * np.pi / period
    fading = np.exp(-p * t)
    waves = p * np.cos(omega * t) + omega * np.sin(omega * t) - p * fading
    both = (1 - fading) / p - waves / (p**2 + omega**2)
    return float(0.5 * source / medium.capacity * both)


def lumped_nonlinear(
    t: Number, capacity: Number, source: Number, sink: Callable[[float], float]
) -> float:
    r"""Rise after $t$ where perfusion depends on it, $\rho c\,\theta' = Q - s(\theta)$.

    By quadrature, $t = \int_0^\theta \rho c\,d\theta'/(Q - s(\theta'))$.

    Args:
        t: time [s].
        capacity: $\rho c$ [J m⁻³ K⁻¹].
        source: $Q$ [W m⁻³].
        sink: $s(\theta) = c_b w \theta$ [W m⁻³].
    """

    def lateness(rise: float) -> float:
        value, _ = scipy.integrate.quad(
            lambda x: capacity / (source - sink(x)),
            0.0,
            rise,
            epsabs=1e-12,
            epsrel=1e-13,
            limit=400,
        )
        return value - t

    ceiling = source * t / capacity
    grid = np.linspace(0.0, ceiling, 4001)
    stuck = [x for x in grid if source - sink(float(x)) <= 0]
    if not stuck:
        return _root(lateness, 0.0, ceiling)
    before = stuck[0] - ceiling / 4000
    steady = _root(lambda x: source - sink(x), before, stuck[0])
    gap = 0.5 * steady
    while lateness(steady - gap) < 0:  # the integral diverges at the steady state
        gap *= 0.5
    return _root(lateness, 0.0, steady - gap)


def _root(function: Callable[[float], Any], low: Number, high: Number) -> float:
    result = scipy.optimize.root_scalar(
        function, bracket=(low, high), method="brentq", rtol=1e-13
    )
    return float(result.root)


def ramp_dose(start: Number, end: Number, minutes: Number, cutoff: Number) -> float:
    r"""CEM43 [min] of a linear ramp upwards, counted from `cutoff`.

    $\frac{\Delta t}{T_1 - T_0}\left[\frac{4^{T-43}}{\ln 4}\Big|_{c}^{43} +
    \frac{2^{T-43}}{\ln 2}\Big|_{43}^{T_1}\right]$.
    """
    low, middle = max(start, cutoff), min(max(end, cutoff), 43.0)
    low = min(low, 43.0)
    below = (4.0 ** (middle - 43) - 4.0 ** (low - 43)) / np.log(4.0)
    bottom, top = max(start, 43.0), max(end, 43.0)
    above = (2.0 ** (top - 43) - 2.0 ** (bottom - 43)) / np.log(2.0)
    return float(minutes / (end - start) * (below + above))
