r"""Exact rises about a heated sphere or point in an infinite or a finite medium.

All functions return the rise $\theta = T - T_a$ [K]. Inverse Laplace transforms are
Talbot's, at 30 digits.

References:
    Andrä et al., J. Magn. Magn. Mater. 194, 197 (1999), the heated sphere; Nyborg,
    Phys. Med. Biol. 33, 785 (1988), the point source.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import mpmath
import numpy as np
import scipy.integrate
import scipy.special
from validation.heat.exact.media import Medium, Number


def kernel(r: Number, s: Number, medium: Medium, radius: Number) -> float:
    r"""Share of a unit of heat per volume, released in the sphere, at $r$ after $s$.

    $b = \tfrac12\left[\mathrm{erf}\tfrac{R+r}{a} + \mathrm{erf}\tfrac{R-r}{a}\right]
    - \sqrt{\tfrac{\alpha s}{\pi}}\,\tfrac1r\left[e^{-((R-r)/a)^2}
    - e^{-((R+r)/a)^2}\right]$, $a = \sqrt{4\alpha s}$, without perfusion.

    Args:
        r: distance from the centre [m].
        s: time since the release [s].
        medium: whose perfusion is left out here.
        radius: $R$ [m].
    """
    a = np.sqrt(4 * medium.diffusivity * s)
    if r < 1e-9 * radius:
        z = radius / a
        return scipy.special.erf(z) - 2 * z / np.sqrt(np.pi) * np.exp(-(z**2))
    near, far = (radius - r) / a, (radius + r) / a
    inside = 0.5 * (scipy.special.erf(far) + scipy.special.erf(near))
    return inside - a / (2 * np.sqrt(np.pi) * r) * (
        np.exp(-(near**2)) - np.exp(-(far**2))
    )


def heated_sphere(
    r: Number,
    t: Number,
    medium: Medium,
    source: Number,
    radius: Number,
) -> float:
    r"""Uniform source in a sphere of an infinite medium, from the rise zero.

    $\theta = \frac{Q}{\rho c} \int_0^t e^{-ps}\, b(r, s)\, ds$.

    Args:
        r: distance from the centre [m].
        t: time [s]; infinity for the steady state.
        medium: with or without perfusion.
        source: $Q$ [W m⁻³].
        radius: $R$ [m].
    """
    if np.isinf(t):
        return _heated_sphere_steady(r, medium, source, radius)
    return source * heated_sphere_kernels(r, t, medium, radius, (0.0, np.inf))[0]


def heated_sphere_kernels(
    r: Number, t: Number, medium: Medium, radius: Number, edges: Sequence[Number]
) -> list[float]:
    r"""Derivative of $\theta(r, t)$ by the source during each interval [K m³ W⁻¹].

    $\frac{1}{\rho c} \int e^{-ps} b(r, s)\, ds$: the adjoint of the heated sphere.
    """
    modes = []
    for begin, end in itertools.pairwise(edges):
        low, high = max(0.0, t - end), max(0.0, t - begin)
        value = _integral(lambda s: kernel(r, s, medium, radius), low, high, medium)
        modes.append(value / medium.capacity)
    return modes


def heated_sphere_sensitivities(
    medium: Medium, source: Number, radius: Number
) -> dict[str, float]:
    r"""Derivatives of the steady rise at the centre, $\frac{Q}{W}[1-(1+mR)e^{-mR}]$.

    Returns:
        By `conductivity`, `perfusion` ($W$), `radius` and `source`.
    """
    W, reach = medium.perfusion, medium.inverse_length * radius
    value = source / W * (1 - (1 + reach) * np.exp(-reach))
    by_reach = source / W * reach * np.exp(-reach)
    return {
        "conductivity": float(-by_reach * reach / (2 * medium.conductivity)),
        "perfusion": float(-value / W + by_reach * reach / (2 * W)),
        "radius": float(by_reach * medium.inverse_length),
        "source": float(value / source),
    }


def _heated_sphere_steady(r: Any, medium: Medium, source: Any, radius: Number) -> Any:
    if not medium.perfusion:
        if r <= radius:
            return source * (radius**2 / 2 - r**2 / 6) / medium.conductivity
        return source * radius**3 / (3 * medium.conductivity * r)
    m, size = medium.inverse_length, source / medium.perfusion
    reach = m * radius
    if r <= radius:
        ratio = np.sinh(m * r) / (m * r) if m * r > 1e-9 else 1.0
        return float(size * (1 - (1 + reach) * np.exp(-reach) * ratio))
    gain = reach * np.cosh(reach) - np.sinh(reach)
    return float(size * gain * np.exp(-m * r) / (m * r))


def _integral(
    function: Callable[[float], Any], low: Number, high: Number, medium: Medium
) -> Any:
    """Integral of e^(-ps) times a function with a square root at 0."""

    def integrand(u: float) -> Any:
        s = u * u
        return 2 * u * np.exp(-medium.rate * s) * function(s) if s > 0 else 0.0

    # In the square root of time the integrand is smooth at zero.
    value, _ = scipy.integrate.quad(
        integrand, np.sqrt(low), np.sqrt(high), epsabs=1e-13, epsrel=1e-13, limit=400
    )
    return value


def point_source(r: Number, t: Number, medium: Medium, power: Number) -> float:
    r"""A point of constant power $q$ [W] in an infinite perfused medium.

    $\frac{q}{8\pi k r}\left[e^{-mr}\,\mathrm{erfc}\left(\tfrac{r}{\sqrt{4\alpha t}} -
    \sqrt{pt}\right) + e^{mr}\,\mathrm{erfc}\left(\tfrac{r}{\sqrt{4\alpha t}} +
    \sqrt{pt}\right)\right]$; steady: $\frac{q}{4\pi k r} e^{-mr}$.
    """
    m, k = medium.inverse_length, medium.conductivity
    if np.isinf(t):
        return float(power / (4 * np.pi * k * r) * np.exp(-m * r))
    front = r / np.sqrt(4 * medium.diffusivity * t)
    lag = np.sqrt(medium.rate * t)
    both = np.exp(-m * r) * scipy.special.erfc(front - lag)
    both += np.exp(m * r) * scipy.special.erfc(front + lag)
    return float(power / (8 * np.pi * k * r) * both)


def two_conductivities(
    r: Number,
    t: Number,
    inner: Medium,
    outer: Medium,
    source: Number,
    radius: Number,
    *,
    outer_radius: Number = np.inf,
) -> float:
    r"""A heated sphere in another medium, neither perfused.

    Steady: $\theta(R) = \frac{QR^2}{3k_2}(1 - R/R_{out})$, inside
    $+\,\frac{Q(R^2 - r^2)}{6k_1}$, outside $\frac{QR^3}{3k_2}(1/r - 1/R_{out})$. The
    transient, in an infinite medium, is inverted from Laplace space.

    Args:
        r: distance from the centre [m].
        t: time [s]; infinity for the steady state.
        inner: the sphere.
        outer: what surrounds it.
        source: $Q$ in the sphere [W m⁻³].
        radius: $R$ [m].
        outer_radius: where the rise is held at zero [m]; steady state only.

    References:
        Andrä et al., J. Magn. Magn. Mater. 194, 197 (1999).
    """
    if np.isinf(t):
        k1, k2 = inner.conductivity, outer.conductivity
        if r > radius:
            return source * radius**3 / (3 * k2) * (1 / r - 1 / outer_radius)
        edge = source * radius**2 / (3 * k2) * (1 - radius / outer_radius)
        return edge + source * (radius**2 - r**2) / (6 * k1)

    def transform(s: Any) -> Any:
        return _two_conductivities_transform(s, r, inner, outer, source, radius)

    return _invert(transform, t)


def _two_conductivities_transform(
    s: Any, r: Any, inner: Medium, outer: Medium, source: Any, radius: Number
) -> Any:
    k1, k2 = inner.conductivity, outer.conductivity
    q1, q2 = (mpmath.sqrt(s / medium.diffusivity) for medium in (inner, outer))
    a, fraction = q1 * radius, source / (inner.capacity * s**2)
    sinh = mpmath.sinh(a)
    both = k2 * (1 + q2 * radius) * sinh
    size = -k2 * (1 + q2 * radius) * fraction * radius
    size /= k1 * (a * mpmath.cosh(a) - sinh) + both
    if r > radius:
        edge = fraction * radius + size * sinh
        return edge * mpmath.exp(-q2 * (r - radius)) / r
    return fraction + size * (mpmath.sinh(q1 * r) / r if r > 0 else q1)


def perfused_spheres(
    r: Number,
    t: Number,
    inner: Medium,
    outer: Medium,
    sources: tuple[Number, Number],
    radii: tuple[Number, Number],
) -> float:
    r"""A perfused sphere in a perfused shell, its outer radius at the arterial value.

    $\theta_{in} = Q_1/W_1 + A \sinh(m_1 r)/r$ and $\theta_{out} = E + B
    \sinh(m_2(R_o-r))/r - E R_o \sinh(m_2(r-R))/(S r)$ with $E = Q_2/W_2$,
    $S = \sinh(m_2(R_o-R))$; $A$, $B$ make $\theta$ and $k\,\partial\theta/\partial r$
    continuous. The transient from zero is the same with $W + s\rho c$ and $Q/s$.

    Args:
        r: distance from the centre [m].
        t: time [s]; infinity for the steady state.
        inner: the sphere, perfused.
        outer: the shell, perfused.
        sources: in both [W m⁻³].
        radii: of both [m].
    """

    def at(s: Any, factor: Any) -> Any:
        def values(medium: Medium, source: Any) -> Any:
            sink = medium.perfusion + s * medium.capacity
            root = mpmath.sqrt(sink / medium.conductivity)
            return medium.conductivity, root, source * factor / sink

        first, second = values(inner, sources[0]), values(outer, sources[1])
        return _two_shells(r, first, second, radii)

    if np.isinf(t):
        return float(mpmath.re(at(mpmath.mpf(0), mpmath.mpf(1))))
    return _invert(lambda s: at(s, 1 / s), t)


def _two_shells(r: Any, inner: Any, outer: Any, radii: Any) -> Any:
    """Both sides from the rise at the edge, which makes the heat flux continuous."""
    (k1, m1, far1), (k2, m2, far2) = inner, outer
    edge, end = radii
    gap = mpmath.sinh(m2 * (end - edge))
    slope1 = m1 * mpmath.coth(m1 * edge) - 1 / mpmath.mpf(edge)
    slope2 = -m2 * mpmath.coth(m2 * (end - edge)) - 1 / mpmath.mpf(edge)
    pull = far2 * end * m2 / (gap * edge)
    rise = k1 * far1 * slope1 - k2 * (far2 * slope2 + pull)
    rise /= k1 * slope1 - k2 * slope2
    if r <= edge:
        shape = mpmath.sinh(m1 * r) / r if r > 0 else m1
        return far1 + (rise - far1) * edge * shape / mpmath.sinh(m1 * edge)
    near = (rise - far2) * edge * mpmath.sinh(m2 * (end - r)) / (gap * r)
    return far2 + near - far2 * end * mpmath.sinh(m2 * (r - edge)) / (gap * r)


def _invert(transform: Callable, t: Number) -> float:
    # Talbot's sum cancels half of its digits, so that doubles would keep too few.
    with mpmath.workdps(30):
        return float(mpmath.invertlaplace(transform, mpmath.mpf(t), method="talbot"))
