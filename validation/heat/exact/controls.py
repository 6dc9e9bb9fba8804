"""Exact solutions that only tests compare with."""

import numpy as np
from validation.heat.exact import Medium


def on_off_cycle(
    medium: Medium, source: float, on: float, off: float
) -> tuple[float, float, float]:
    r"""Highest, lowest and mean rise of lumped tissue in its periodic state [K].

    $\frac{Q}{W}\frac{1-e^{-p t_1}}{1-e^{-p(t_1+t_0)}}$, the same times
    $e^{-p t_0}$, and $\frac{Q}{W}\frac{t_1}{t_1+t_0}$.
    """
    p, size = medium.rate, source / medium.perfusion
    high = size * np.expm1(-p * on) / np.expm1(-p * (on + off))
    return float(high), float(high * np.exp(-p * off)), float(size * on / (on + off))


def least_energy_control(
    t: float, decay: float, gain: float, rises: tuple[float, float], end: float
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
    decay: float, gain: float, rises: tuple[float, float], end: float
) -> float:
    r"""Its $\int u^2 dt = 2\lambda D^2 / (b^2 (1 - e^{-2\lambda t_f}))$."""
    distance = rises[1] - rises[0] * np.exp(-decay * end)
    return float(2 * decay * distance**2 / (-(gain**2) * np.expm1(-2 * decay * end)))


def saturate_and_ride(
    decay: float, gain: float, highest: float, power: float
) -> tuple[float, float]:
    r"""The control of most CEM43 under $u \le u_{max}$, $\theta \le \theta_{max}$.

    Full power until $t_s = -\ln(1 - \lambda\theta_{max}/(b u_{max}))/\lambda$, then
    $u = \lambda\theta_{max}/b$.

    Returns:
        $t_s$ [s], and the power that rides the limit.
    """
    hold = decay * highest / gain
    return float(-np.log1p(-hold / power) / decay), float(hold)


def discrete_eigenmode_rate(
    medium: Medium, mode: int, length: float, num_cells: int
) -> float:
    r"""Decay of $\cos(n\pi x/L)$ by differences, $\alpha(2-2\cos(n\pi/N))/h^2 + p$."""
    curvature = (2 - 2 * np.cos(mode * np.pi / num_cells)) * (num_cells / length) ** 2
    return float(medium.diffusivity * curvature + medium.rate)
