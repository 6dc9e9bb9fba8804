r"""Exact answers without space: lumped tissue, doses of ramps, optimal controls."""

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.integrate
import scipy.optimize

from pinav.thermal.exact.media import Medium, Number


def lumped_rise(t: Number, medium: Medium, source: Number) -> float:
    r"""$\theta = \frac{Q}{W}(1 - e^{-pt})$ [K]."""
    return float(-source / medium.perfusion * np.expm1(-medium.rate * t))


def lumped_by_perfusion(t: Number, medium: Medium, source: Number) -> float:
    r"""$\partial\theta/\partial W$ of the lumped rise [K² m³ W⁻¹]."""
    p, W = medium.rate, medium.perfusion
    fading = np.exp(-p * t)
    return float(source / W**2 * (p * t * fading - (1 - fading)))


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


def on_off_cycle(
    medium: Medium, source: Number, on: Number, off: Number
) -> tuple[float, float, float]:
    r"""Highest, lowest and mean rise of lumped tissue in its periodic state [K].

    $\frac{Q}{W}\frac{1-e^{-p t_1}}{1-e^{-p(t_1+t_0)}}$, the same times
    $e^{-p t_0}$, and $\frac{Q}{W}\frac{t_1}{t_1+t_0}$.
    """
    p, size = medium.rate, source / medium.perfusion
    high = size * np.expm1(-p * on) / np.expm1(-p * (on + off))
    return float(high), float(high * np.exp(-p * off)), float(size * on / (on + off))


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


def least_energy_control(
    t: Number, decay: Number, gain: Number, rises: tuple[Number, Number], end: Number
) -> float:
    r"""The $u$ of least $\int u^2 dt$ that takes $\theta' = -\lambda\theta + bu$ there.

    $u = \frac{2\lambda D\, e^{-\lambda(t_f-t)}}{b(1 - e^{-2\lambda t_f})}$,
    $D = \theta_f - \theta_0 e^{-\lambda t_f}$.

    Args:
        t: time [s].
        decay: $\lambda$ [s⁻¹].
        gain: $b$ [K s⁻¹ per unit of $u$].
        rises: $\theta_0$ and $\theta_f$ [K].
        end: $t_f$ [s].
    """
    distance = rises[1] - rises[0] * np.exp(-decay * end)
    growth = np.exp(-decay * (end - t))
    return float(2 * decay * distance * growth / (-gain * np.expm1(-2 * decay * end)))


def least_energy(
    decay: Number, gain: Number, rises: tuple[Number, Number], end: Number
) -> float:
    r"""Its $\int u^2 dt = 2\lambda D^2 / (b^2 (1 - e^{-2\lambda t_f}))$."""
    distance = rises[1] - rises[0] * np.exp(-decay * end)
    return float(2 * decay * distance**2 / (-(gain**2) * np.expm1(-2 * decay * end)))


def saturate_and_ride(
    decay: Number, gain: Number, highest: Number, power: Number
) -> tuple[float, float]:
    r"""The control of most CEM43 under $u \le u_{max}$, $\theta \le \theta_{max}$.

    Full power until $t_s = -\ln(1 - \lambda\theta_{max}/(b u_{max}))/\lambda$, then
    $u = \lambda\theta_{max}/b$.

    Returns:
        $t_s$ [s], and the power that rides the limit.
    """
    hold = decay * highest / gain
    return float(-np.log1p(-hold / power) / decay), float(hold)
