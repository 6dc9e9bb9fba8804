r"""Evidence of hypotheses that add known columns to a field of kernels.

Data $y$ are explained by kernels with a Gaussian prior, by columns with a flat one, and
by columns whose coefficient is known. With $R$ the data of each weight, $K$ the prior
and $S = 1 + R K R^\top / \beta$ the covariance in units of the noise $\sigma^2$, the
evidence of a hypothesis with the residuals $r$ of its known columns and the k flat
columns $F$ is

$$-2 \log Z = (n - k) \log 2\pi\sigma^2 + q / \sigma^2 + \log\det S
  + \log\det F^\top S^{-1} F,\quad
  q = r^\top S^{-1} r - r^\top S^{-1} F (F^\top S^{-1} F)^{-1} F^\top S^{-1} r.$$

All of this follows from the products $A^\top S^{-1} A$ of all columns, data included,
so that one eigenvalue problem a prior serves any number of hypotheses.

References:
    Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), section 2.7;
    Patterson and Thompson, Biometrika 58, 545 (1971).
"""

from collections.abc import Iterable, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from pinav.fitting.evidence.evidence import root
from pinav.forces.priors import Matrix

RATIOS = np.exp(np.linspace(-30.0, 0.0, 61))
r"""Ratios $\beta$ that are tried, relative to the largest variance of the prior."""

SEEN = 1e-6
"""Size of a direction of flat columns, relative to the largest, that the data see."""


class Hypothesis(eqx.Module):
    """Columns beside the kernels.

    Attributes:
        known: coefficient of each of all columns, the data being the first.
        flat: columns with coefficients of a flat prior, which is one unit long.
    """

    known: Float[np.ndarray, " column"]
    flat: Int[np.ndarray, " flat"]


class ColumnFit(eqx.Module):
    """The best fit of a hypothesis.

    Attributes:
        values: of the flat coefficients.
    """

    log_evidence: float
    noise: float
    values: Float[np.ndarray, " flat"]


class Products(eqx.Module):
    r"""Products of all columns under one prior, for several ratios $\beta$.

    Attributes:
        grams: $A^\top S^{-1} A$.
        log_determinants: of $S$.
    """

    grams: Float[np.ndarray, "ratio column column"]
    log_determinants: Float[np.ndarray, " ratio"]


def column_products(
    rows: Float[np.ndarray, "datum weight"],
    columns: Float[np.ndarray, "datum column"],
    priors: Iterable[Matrix],
) -> list[Products]:
    """Products under each of several priors of the weights."""
    basis, square = np.linalg.qr(rows)
    inside = basis.T @ columns
    outside = columns - basis @ inside
    rest = outside.T @ outside
    return [_products(square @ root(prior), inside, rest) for prior in priors]


def _products(
    reached: Float[np.ndarray, "datum direction"],
    columns: Float[np.ndarray, "datum column"],
    rest: Float[np.ndarray, "column column"],
) -> Products:
    left, sizes, _ = np.linalg.svd(reached)
    variances = np.zeros(len(left))
    variances[: len(sizes)] = sizes**2
    ratios = max(variances.max(initial=0.0), np.finfo(float).tiny) * RATIOS
    shares = ratios[:, None] / (variances + ratios[:, None])
    # Weighted columns, not differences of products, which would lose half of the digits.
    weighted = np.sqrt(shares)[:, :, None] * (left.T @ columns)
    grams = np.swapaxes(weighted, 1, 2) @ weighted + rest
    return Products(grams, -np.log(shares).sum(axis=1))


def best_column_fit(
    products: Sequence[Products],
    hypothesis: Hypothesis,
    *,
    squares: float,
    count: int,
    noise: float | None,
) -> ColumnFit:
    """The fit of a hypothesis under the likeliest of the priors and ratios.

    Args:
        squares: that nothing explains, beside those of the data.
        count: number of data, less flat unknowns that are eliminated already.
        noise: standard deviation, where it is known.
    """
    known, flat = hypothesis.known, hypothesis.flat
    free, fits = count - len(flat), []
    for one in products:
        pull = (one.grams @ known)[:, flat]
        left = np.einsum("i,rij,j->r", known, one.grams, known) + squares
        block = one.grams[:, flat[:, None], flat]
        values = -np.linalg.solve(block, pull[..., None])[..., 0]
        left = np.maximum(left + np.sum(pull * values, axis=1), np.finfo(float).tiny)
        variance = left / free if noise is None else np.full(len(left), noise**2)
        log_evidence = -0.5 * (
            free * np.log(2 * np.pi * variance)
            + left / variance
            + one.log_determinants
            + np.linalg.slogdet(block)[1]
        )
        best = int(np.argmax(log_evidence))
        fits.append(
            ColumnFit(
                float(log_evidence[best]), float(np.sqrt(variance[best])), values[best]
            )
        )
    return max(fits, key=lambda fit: fit.log_evidence)


def seen_directions(
    columns: Float[np.ndarray, "datum column"],
) -> Float[np.ndarray, "datum direction"]:
    """An orthonormal basis of what columns change in the data."""
    lengths = np.linalg.norm(columns, axis=0)
    columns = columns[:, lengths > 0] / lengths[lengths > 0]
    if not columns.shape[1]:
        return columns
    left, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, sizes > SEEN * sizes[0]]
