r"""What is known of a sphere above a wall: hydrodynamics, weight and Boltzmann's law.

Mobilities near a plane wall are known to 1 % in shape, their scale $D_0$ only as well
as temperature, viscosity and the camera's scale. So a learned diffusion is scored
twice: with $D_0$ free and with $D_0$ given; where the wall stands is free in both.

References:
    Brenner, Chem. Eng. Sci. 16, 242 (1961); Lavaud et al., Phys. Rev. Research 3,
    L032011 (2021).
"""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import least_squares

from pinav.errors import InputError
from pinav.fitting import Estimate
from pinav.forces import parallel_mobility
from pinav.forces.walls import LEAST_GAP

Mobility = Callable[[Float[Array, " gap"]], Float[Array, " gap"]]

BLOCKS = 20
"""Blocks of a recording that are left out in turn."""

TERMS = 600
"""Terms of Brenner's series: at `LEAST_GAP` the last one is below 1e-20."""


def brenner_mobility(gap: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    r"""Mobility normal to a wall, by Brenner's exact series.

    $$\frac{D_0}{D_\perp} = \frac43 \sinh\alpha \sum_{n \ge 1}
    \frac{n (n + 1)}{(2n - 1)(2n + 3)} \left[\frac{2 \sinh m\alpha + m \sinh 2\alpha}
    {4 \sinh^2 (m \alpha / 2) - m^2 \sinh^2\alpha} - 1\right],$$

    $m = 2n + 1$, $\cosh\alpha = 1 + \epsilon$. Exact from `LEAST_GAP` on.

    Args:
        gap: $\epsilon$, positive.

    References:
        Brenner, Chem. Eng. Sci. 16, 242 (1961).
    """
    alpha = jnp.arccosh(1 + jnp.maximum(gap, LEAST_GAP))[..., None]
    n = jnp.arange(1.0, TERMS + 1, dtype=alpha.dtype).reshape((1,) * gap.ndim + (-1,))
    m = 2 * n + 1
    # Numerator and denominator are divided by exp(m alpha), which would overflow.
    decay = jnp.exp(-m * alpha)
    square = m**2 * jnp.sinh(alpha) ** 2 * decay
    rest = (2 + m * jnp.sinh(2 * alpha)) * decay + square - 2 * decay**2
    below = 1 + decay**2 - 2 * decay - square
    terms = n * (n + 1) / ((2 * n - 1) * (2 * n + 3)) * rest / below
    return 1 / (4 / 3 * jnp.sinh(alpha[..., 0]) * jnp.sum(terms, axis=-1))


class WallScore(eqx.Module):
    """A learned diffusion beside hydrodynamics.

    Attributes:
        contact: height of the centre at contact that suits the diffusion [L].
        bulk: $D_0$, free or given [L² T⁻¹].
        error: root mean square of the relative error at heights above the least gap.
        theory: the diffusion of the theory at all heights [L² T⁻¹].
    """

    contact: float
    bulk: float
    error: float
    theory: Float[np.ndarray, " height"]


def wall_score(
    heights: Float[np.ndarray, " height"],
    diffusion: Float[np.ndarray, " height"],
    radius: float,
    *,
    normal: bool,
    sd: Float[np.ndarray, " height"] | None = None,
    bulk: float | None = None,
    least_gap: float = 0.0,
) -> WallScore:
    """Score a diffusion against the mobility near a wall, which is placed to suit it.

    It is placed by least squares of the logarithm, weighted by the standard deviations
    where they are given.

    Args:
        heights: of the centre, from any zero [L].
        diffusion: learned, normal to the wall or along it [L² T⁻¹].
        radius: of the sphere [L].
        normal: to the wall, by Brenner's series; else along it.
        sd: standard deviation of the diffusion [L² T⁻¹]; alike in the logarithm at all
            heights unless given.
        bulk: $D_0$; free unless given.
        least_gap: gap above which errors count [L].

    Raises:
        InputError: fewer than four heights, or a diffusion is not positive.
    """
    if len(heights) < 4 or not (diffusion > 0).all():
        raise InputError(
            "wall_score: expected four or more heights with a positive diffusion, got "
            f"{len(heights)}"
        )
    mobility = brenner_mobility if normal else parallel_mobility
    weights = np.ones_like(diffusion) if sd is None else diffusion / sd
    weights = weights / np.sqrt(np.mean(weights**2))

    def log_theory(contact: float, log_bulk: float) -> np.ndarray:
        gaps = np.maximum((heights - contact) / radius, 1e-3)
        return log_bulk + np.log(np.asarray(mobility(jnp.asarray(gaps))))

    def misfit(numbers: np.ndarray) -> np.ndarray:
        log_bulk = np.log(bulk) if bulk is not None else numbers[1]
        excess = log_theory(numbers[0] * radius, log_bulk) - np.log(diffusion)
        return weights * excess

    lowest, top = heights.min() / radius, float(np.log(diffusion.max()))
    starts = [lowest - gap for gap in (0.01, 0.05, 0.3)]
    runs = [least_squares(misfit, [s, top][: 2 - (bulk is not None)]) for s in starts]
    best = min(runs, key=lambda run: run.cost).x
    contact = float(best[0] * radius)
    log_bulk = float(np.log(bulk) if bulk is not None else best[1])
    theory = np.exp(log_theory(contact, log_bulk))
    counted = heights - contact > least_gap
    error = np.sqrt(np.mean((diffusion / theory - 1)[counted] ** 2))
    return WallScore(contact, float(np.exp(log_bulk)), float(error), theory)


def boltzmann_force(
    heights: Float[np.ndarray, " frame"],
    low: float,
    high: float,
    thermal_energy: float,
) -> Estimate:
    r"""Mean force $k_B T\, d\ln p / dh$ between two heights, from the density alone.

    The maximum of the likelihood of an exponential density between the two; its error
    is that of blocks which are left out in turn, because heights are correlated.

    Args:
        heights: above the wall, one a frame in the order of time [L].
        low: least height that counts [L].
        high: greatest height that counts [L].
        thermal_energy: $k_B T$ [F L].

    Raises:
        InputError: fewer than 100 heights lie between the two.
    """
    inside = (heights > low) & (heights < high)
    if inside.sum() < 100:
        raise InputError(
            f"boltzmann_force: expected 100 heights or more from {low:g} to {high:g}, "
            f"got {inside.sum()}"
        )
    blocks = np.arange(len(heights)) * BLOCKS // len(heights)

    def slope(keep: np.ndarray) -> float:
        return _exponential_slope(float(np.mean(heights[keep] - low)), high - low)

    value = slope(inside)
    left_out = np.array([slope(inside & (blocks != b)) for b in range(BLOCKS)])
    spread = ((left_out - left_out.mean()) ** 2).sum()
    sd = float(np.sqrt((BLOCKS - 1) / BLOCKS * spread))
    return Estimate(thermal_energy * value, thermal_energy * sd)


def _exponential_slope(mean: float, width: float) -> float:
    """Slope s of a density exp(s h) on an interval from its mean, by Newton's steps."""
    slope = 12 * (mean / width - 0.5) / width
    for _ in range(50):
        x = slope * width / 2
        if abs(x) < 1e-4:
            return slope
        expected = width / 2 * (1 + 1 / np.tanh(x) - 1 / x)
        derivative = width**2 / 4 * (1 / x**2 - 1 / np.sinh(x) ** 2)
        step = np.clip((mean - expected) / derivative, -3 / width, 3 / width)
        slope += step
        if abs(step) < 1e-10 / width:
            break
    return float(slope)
