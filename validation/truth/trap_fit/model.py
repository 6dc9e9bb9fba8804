r"""Exact propagators of a bead in a linear trap, and of its mean over an exposure.

References:
    Wong and Halvorsen, Opt. Express 14, 12517 (2006), the blur; Van Loan, IEEE Trans.
    Autom. Control 23, 395 (1978), the propagators.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float


class TrapModel(NamedTuple):
    r"""Numbers of a trap; times and lengths in any units.

    Attributes:
        rate: $\lambda$ [T⁻¹].
        diffusion: $D$ [L² T⁻¹].
        exposure: $T$ [T], positive.
        error: standard deviation of the localisation [L].
        wander: standard deviation of the wandering trap [L]; 0 where it rests.
        memory: correlation time of its wander [T].
    """

    rate: Float[Array, ""]
    diffusion: Float[Array, ""]
    exposure: Float[Array, ""]
    error: Float[Array, ""]
    wander: Float[Array, ""]
    memory: Float[Array, ""]


class Propagator(NamedTuple):
    """From one frame to the next, of e and of its mean over the exposure.

    Attributes:
        decay: of e.
        reach: of the later mean over the exposure from e.
        noise: variance that e gains.
        mixed: covariance of the gains of both.
        blurred: variance that the mean over the exposure gains.
    """

    decay: Float[Array, "*step"]
    reach: Float[Array, "*step"]
    noise: Float[Array, "*step"]
    mixed: Float[Array, "*step"]
    blurred: Float[Array, "*step"]


def propagate(trap: TrapModel, intervals: Float[Array, "*step"]) -> Propagator:
    r"""Exact propagators over intervals [T], none shorter than the exposure."""
    variance, ratio = trap.diffusion / trap.rate, trap.rate * trap.exposure
    shut = trap.rate * (intervals - trap.exposure)
    before, during = jnp.exp(-shut), jnp.exp(-ratio)
    mean = -jnp.expm1(-ratio) / ratio
    waiting = -variance * jnp.expm1(-2 * shut)
    mixed = variance * ratio * mean**2
    blurred = 2 * variance * _ramp(ratio) / ratio**2
    return Propagator(
        decay=before * during,
        reach=before * mean,
        noise=-variance * jnp.expm1(-2 * (shut + ratio)),
        mixed=during * mean * waiting + mixed,
        blurred=mean**2 * waiting + blurred,
    )


def _ramp(ratio: Float[Array, ""]) -> Float[Array, ""]:
    """About a third of x³: x - 2 (1 - exp(-x)) + (1 - exp(-2 x)) / 2."""
    small = jnp.minimum(ratio, 0.03)
    series = sum(
        (-1) ** (k + 1) * (2 ** (k - 1) - 2) / math.factorial(k) * small**k
        for k in range(3, 9)
    )
    full = ratio + 2 * jnp.expm1(-ratio) - jnp.expm1(-2 * ratio) / 2
    return jnp.where(ratio < 0.03, series, full)  # where all digits cancel


def blur_factor(ratio: float | Array) -> Array:
    r"""Recorded variance over the true one, $2 (x - 1 + e^{-x}) / x^2$.

    Args:
        ratio: $x = \lambda T$, exposure over relaxation time.

    References:
        Wong and Halvorsen, Opt. Express 14, 12517 (2006).
    """
    ratio = jnp.asarray(ratio, float)
    small = jnp.minimum(ratio, 0.01)
    series = 1 - small / 3 + small**2 / 12 - small**3 / 60 + small**4 / 360
    full = 2 * (ratio + jnp.expm1(-ratio)) / jnp.maximum(ratio, 0.01) ** 2
    return jnp.where(ratio < 0.01, series, full)
