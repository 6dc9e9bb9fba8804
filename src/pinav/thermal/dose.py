r"""Thermal dose: CEM43, Arrhenius damage, and what of a target they reach.

$\mathrm{CEM43} = \int R^{43-T} dt$ in minutes, $R = 0.5$ from 43 °C on and 0.25 below,
nothing below a cut-off. Between two time steps temperature is a straight line, for
which the integral has a closed form: a rectangle is 34 % off at one step a minute.

References:
    Sapareto and Dewey, Int. J. Radiat. Oncol. Biol. Phys. 10, 787 (1984).
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar
from pinav.thermal.quantities import Energy, Field, LogFactor, Number

BREAK = 43.0
"""Temperature [°C] at which the rate of CEM43 changes."""

GAS_CONSTANT = 8.314462618
"""$R_g$ [J mol⁻¹ K⁻¹]."""

ZERO_CELSIUS = 273.15
"""In kelvin."""


def cem43_segment(
    begin: Field, end: Field, duration: Scalar, cutoff: Scalar = 37.0
) -> Field:
    r"""CEM43 [min] of a temperature that goes linearly from `begin` to `end` [°C].

    $\Delta t\,[G(T_1) - G(T_0)]/(T_1 - T_0)$ with $G = 2^{T-43}/\ln 2$ above 43 °C and
    $4^{T-43}/\ln 4$ below, split at 43 °C and at the cut-off; exact.

    Args:
        duration: of the segment [s].
        cutoff: temperature [°C] below which nothing counts.
    """
    return _mean_rate(begin, end, jnp.asarray(cutoff)) * (duration / 60.0)


def _mean_rate(begin: Any, end: Any, cutoff: Any) -> Field:
    first = _doubling(begin, cutoff)
    last = _doubling(end, cutoff)
    # of two powers of two alone: exponentials are what a dose costs
    low, high = _within(first, 0.0, 1.0), _within(last, 0.0, 1.0)
    rise = (
        2 * np.log(2.0) * (_within(end, cutoff, BREAK) - _within(begin, cutoff, BREAK))
    )
    below = _mean(low**2, high**2, low * high, rise)
    low, high = _within(first, 1.0, np.inf), _within(last, 1.0, np.inf)
    rise = np.log(2.0) * (_within(end, BREAK, np.inf) - _within(begin, BREAK, np.inf))
    above = _mean(low, high, jnp.sqrt(low * high), rise)
    below = _share(begin, end, cutoff, BREAK) * below
    above = _share(begin, end, BREAK, np.inf) * above
    return below + above


def _within(value: Any, low: Any, high: Any) -> Field:
    """The nearest value in a range; a bound itself moves as what is above it."""
    return jnp.where(value >= high, high, jnp.where(value >= low, value, low))


def _doubling(temperature: Any, cutoff: Any) -> Field:
    return jnp.exp2(_within(temperature, cutoff, np.inf) - BREAK)


SMALL_GROWTH = 0.35
"""Growth up to which a series is exact, and beyond which a difference is."""


def _mean(first: Any, last: Any, middle: Any, growth: Any) -> Field:
    r"""Mean of an exponential between two of its values.

    $(R_1 - R_0)/z$ with $z = \ln(R_1/R_0)$; for small $z$, where that cancels,
    $\sqrt{R_0 R_1}\,\sinh(z/2)/(z/2)$ by its series, whose derivative has no noise.
    """
    small = jnp.abs(growth) < SMALL_GROWTH
    square = growth**2
    series = 1 + square / 24 * (
        1 + square / 80 * (1 + square / 168 * (1 + square / 288))
    )
    quotient = (last - first) / jnp.where(small, 1.0, growth)
    return jnp.where(small, middle * series, quotient)


def _share(begin: Any, end: Any, low: Any, high: Any) -> Field:
    """Share of the time that a segment spends between two temperatures.

    A quotient of two small numbers only where the segment crosses a bound: elsewhere
    its derivative would be noise.
    """

    def within(temperature: Any) -> Any:
        return (temperature >= low) & (temperature < high)

    crosses = within(begin) != within(end)
    spans = ((begin < low) & (end >= high)) | ((end < low) & (begin >= high))
    partly = crosses | spans
    change = jnp.where(partly, end - begin, 1.0)
    part = (_within(end, low, high) - _within(begin, low, high)) / change
    return jnp.where(partly, part, jnp.where(within(begin), 1.0, 0.0))


class Arrhenius(eqx.Module):
    r"""Damage, $d\Omega/dt = A e^{-E_a/(R_g T)}$, of which $1 - e^{-\Omega}$ dies.

    Attributes:
        log_factor: $\ln A$, with $A$ in s⁻¹; $A$ itself can be 1e98.
        energy: $E_a$ [J mol⁻¹].
    """

    log_factor: Scalar = eqx.field(metadata={"range": LogFactor})
    energy: Scalar = eqx.field(metadata={"range": Energy})

    def rate(self, temperature: Field) -> Field:
        r"""$d\Omega/dt$ [s⁻¹] at temperatures [°C]."""
        kelvin = temperature + ZERO_CELSIUS
        return jnp.exp(self.log_factor - self.energy / (GAS_CONSTANT * kelvin))

    def segment(self, begin: Field, end: Field, duration: Scalar) -> Field:
        r"""$\Omega$ of a linear change of temperature, by three nodes of Gauss."""
        middle, half = 0.5 * (begin + end), 0.5 * np.sqrt(0.6) * (end - begin)
        outer = self.rate(middle - half) + self.rate(middle + half)
        return duration / 18 * (5 * outer + 8 * self.rate(middle))


SKIN_DAMAGE = Arrhenius(float(np.log(3.1) + 98 * np.log(10.0)), 6.28e5)
"""Henriques and Moritz, Am. J. Pathol. 23, 530 (1947)."""

LIVER_DAMAGE = Arrhenius(float(np.log(7.39) + 39 * np.log(10.0)), 2.577e5)
"""A set in use for liver; its origin is not checked."""


DAMAGES = {"skin": SKIN_DAMAGE, "liver": LIVER_DAMAGE}
"""By the name of the tissue."""


def value_exceeded_by(
    values: Field, weights: Field, fraction: Number
) -> Float[Array, ""]:
    r"""The value that a share of a volume exceeds: T90 for 0.9, D90 of a dose.

    Cells are sorted; between the middles of their volumes the value is linear.

    Args:
        values: temperature or dose of each cell.
        weights: volume of each cell in the target, zero outside it.
        fraction: of the target's volume, between 0 and 1.
    """
    flat, sizes = values.reshape(-1), weights.reshape(-1)
    least = jnp.min(jnp.where(sizes > 0, flat, jnp.inf))
    flat = jnp.where(sizes > 0, flat, least)  # at the end of the order, without weight
    order = jnp.argsort(-flat)
    flat, sizes = flat[order], sizes[order]
    total = jnp.cumsum(sizes)
    middles = (total - 0.5 * sizes) / total[-1]
    return jnp.interp(fraction, middles, flat)


def volume_above(values: Field, weights: Field, level: Scalar) -> Float[Array, ""]:
    """Share of the target's volume with a value above `level`, such as V43."""
    above = jnp.where(values > level, weights, 0.0)
    return jnp.sum(above) / jnp.sum(weights)


def time_to_reach(
    times: Float[np.ndarray, " time"], doses: Float[np.ndarray, " time"], level: Number
) -> float | None:
    """Time [s] at which a growing dose reaches a level [min]; none if it does not."""
    if not doses[-1] >= level:
        return None
    after = int(np.argmax(doses >= level))
    if after == 0:
        return float(times[0])
    # doses grow by the exponential of the temperature: linear between two times
    low, high = doses[after - 1], doses[after]
    fraction = (level - low) / (high - low)
    return float(times[after - 1] + fraction * (times[after] - times[after - 1]))
