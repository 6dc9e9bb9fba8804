r"""Covariance of blurred, noisy increments: three bands, and what is done with them.

$\Delta_n = y_{n+1} - y_n$ of positions that a camera averages over the exposure T
before $t_n$, with an error of standard deviation $\sigma$, have

$$\operatorname{var}\Delta_n = 2 D_n f_n \tau_n - \tfrac13(1 + 3\kappa_n^2) D_n T
  + \tfrac23 \kappa_n^2 D_{n-1}T + (1 + \kappa_n^2)\sigma^2,\quad
  \operatorname{cov}(\Delta_n, \Delta_{n+1})
  = \kappa_{n+1}(\tfrac13 D_n T - \sigma^2),$$

and nothing beyond, where the drift leaves a share $\kappa_n$ of a displacement and
$f_n = (1 - \kappa_n^2)/(-2\log\kappa_n)$ of the variance: what a position lacks and
errs is in the mean of the next increment, too. It is that of a trap to first order in
the relaxation within an exposure. Everything is
linear in their number: the factor, solutions and the bands of the inverse are
recursions in time, for all tracks and axes at once.

References:
    Berglund, Phys. Rev. E 82, 011917 (2010); Vestergaard, Blainey and Flyvbjerg,
    Phys. Rev. E 89, 022726 (2014).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.arguments import Scalar

Rows = Float[Array, "time *rows"]
"""A number for each increment, time first; tracks (and axes) side by side."""

UNROLL = 8
"""Steps of a recursion that are compiled as one."""


class Tridiagonal(eqx.Module):
    """A symmetric tridiagonal matrix for each row.

    Attributes:
        beside: of each increment with the next one; the last is without effect.
    """

    diagonal: Rows
    beside: Rows


class TridiagonalFactor(eqx.Module):
    r"""Lower factor L of the bands, $\Sigma = L L^\top$.

    Attributes:
        diagonal: $l_n$.
        below: $m_n$, from each increment to the next one.
    """

    diagonal: Rows
    below: Rows

    @property
    def log_determinant(self) -> Float[Array, ""]:
        r"""$\log\det\Sigma$ of all rows."""
        return 2 * jnp.sum(jnp.log(self.diagonal))


def increment_bands(
    diffusion: Rows,
    intervals: Rows,
    exposure: Scalar | Rows,
    variance: Scalar | Rows,
    kept: Rows,
) -> Tridiagonal:
    r"""Covariance of increments.

    Args:
        diffusion: $D_n f_n$ over each interval [L² T⁻¹].
        intervals: $\tau_n$ [T]; an exposure longer than one counts as that long.
        exposure: T.
        variance: $\sigma^2$ [L²].
        kept: share of a displacement that is left after an interval, one where the
            drift does not relax it.
    """
    # What is blurred is motion at the end of an interval, which nothing relaxed yet.
    rate = -jnp.log(kept)
    is_short = jnp.abs(rate) < SHORT
    relaxed = jnp.where(
        is_short, 1 - rate, (1 - kept**2) / jnp.where(is_short, 1.0, 2 * rate)
    )
    blurred = diffusion / relaxed * jnp.minimum(exposure, intervals) / 3
    before = jnp.concatenate([blurred[:1], blurred[:-1]])
    return Tridiagonal(
        2 * diffusion * intervals
        + kept**2 * (2 * before - 3 * blurred)
        - blurred
        + (1 + kept**2) * variance,
        jnp.concatenate([kept[1:], kept[-1:]]) * (blurred - variance),
    )


SHORT = 1e-4
"""Relaxation in an interval below which its variance is that of its first order."""


def cut(bands: Tridiagonal, mask: Rows) -> Tridiagonal:
    """The bands with unit variance and no neighbours where there is no increment.

    Args:
        mask: one where there is an increment, else zero.
    """
    # Padding is independent and of unit variance: it adds nothing to the likelihood.
    follows = jnp.concatenate([mask[1:], jnp.zeros_like(mask[:1])])
    return Tridiagonal(
        jnp.where(mask > 0, bands.diagonal, 1.0),
        jnp.where(follows > 0, bands.beside, 0.0),
    )


def factorise(bands: Tridiagonal) -> TridiagonalFactor:
    """The lower factor; a variance that rounding makes negative counts as tiny."""

    def step(carry: Array, row: tuple[Array, Array]) -> tuple[Array, tuple]:
        variance, beside = row
        # Rounding may leave no variance where the localisation error is nearly all of
        # it.
        left = jnp.maximum(variance - carry**2, LEAST * variance)
        root = jnp.sqrt(left)
        below = beside / root
        return below, (root, below)

    start = jnp.zeros_like(bands.diagonal[0])
    rows = bands.diagonal, bands.beside
    return TridiagonalFactor(*jax.lax.scan(step, start, rows, unroll=UNROLL)[1])


LEAST = 1e-10
"""Share of its variance that an increment keeps, given all before it, at least."""


def whiten(factor: TridiagonalFactor, values: Rows) -> Rows:
    """$L^{-1} r$: what each increment adds to those before it (innovations)."""

    def step(carry: Array, row: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        value, root, before = row
        new = (value - before * carry) / root
        return new, new

    before = jnp.concatenate([jnp.zeros_like(factor.below[:1]), factor.below[:-1]])
    rows = values, factor.diagonal, before
    return jax.lax.scan(step, jnp.zeros_like(values[0]), rows, unroll=UNROLL)[1]


def pull_back(factor: TridiagonalFactor, values: Rows) -> Rows:
    r"""$L^{-\top} w$; of innovations it is $\Sigma^{-1} r$."""

    def step(carry: Array, row: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        value, root, below = row
        new = (value - below * carry) / root
        return new, new

    rows = values, factor.diagonal, factor.below
    start = jnp.zeros_like(values[0])
    return jax.lax.scan(step, start, rows, reverse=True, unroll=UNROLL)[1]


def inverse_bands(factor: TridiagonalFactor) -> Tridiagonal:
    r"""The three bands of $\Sigma^{-1}$.

    $Z_{nn} = l_n^{-2} + (m_n/l_n)^2 Z_{n+1,n+1}$ and
    $Z_{n+1,n} = -(m_n/l_n) Z_{n+1,n+1}$, from the end.
    """

    def step(carry: Array, row: tuple[Array, Array]) -> tuple[Array, tuple]:
        root, below = row
        # Takahashi's recursion: the bands of the inverse without the inverse.
        ratio = below / root
        here = root**-2 + ratio**2 * carry
        return here, (here, -ratio * carry)

    rows = factor.diagonal, factor.below
    start = jnp.zeros_like(factor.diagonal[0])
    return Tridiagonal(*jax.lax.scan(step, start, rows, reverse=True, unroll=UNROLL)[1])


class LikelihoodScore(eqx.Module):
    r"""Log likelihood of increments without drift, and its slopes.

    Attributes:
        value: the log density of all rows, less that of the padding.
        by_bands: its derivative by each entry of the bands.
        pulled: $\Sigma^{-1} r$, its derivative by the mean.
    """

    value: Float[Array, ""]
    by_bands: Tridiagonal
    pulled: Rows


def score(bands: Tridiagonal, residuals: Rows) -> LikelihoodScore:
    r"""Log likelihood $-\tfrac12(r^\top\Sigma^{-1}r + \log\det\Sigma)$ and its slopes.

    Args:
        bands: the covariance, cut to the mask.
        residuals: increments less their mean; zero in the padding.
    """
    factor = factorise(bands)
    innovations = whiten(factor, residuals)
    pulled = pull_back(factor, innovations)
    inverse = inverse_bands(factor)
    following = jnp.concatenate([pulled[1:], jnp.zeros_like(pulled[:1])])
    return LikelihoodScore(
        -0.5 * (jnp.sum(innovations**2) + factor.log_determinant),
        Tridiagonal(
            0.5 * (pulled**2 - inverse.diagonal), pulled * following - inverse.beside
        ),
        pulled,
    )
