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

from collections.abc import Iterator, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from pinav.fitting.evidence.evidence import root
from pinav.forces.priors import Matrix

RATIOS = np.exp(np.linspace(-30.0, 0.0, 61))
r"""Ratios $\beta$ that are tried, relative to the largest variance of the prior."""

SEEN = 1e-6
"""Size of a direction of flat columns, relative to the largest, that the data see."""


Columns = Int[np.ndarray, "_"]
"""Indices of columns."""

NONE = np.zeros(0, int)
"""No column."""


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


class ColumnWeigher(eqx.Module):
    """The evidence of columns beside kernels.

    Attributes:
        products: of each set of columns that stand beside the kernels.
        counts: of the data, less flat unknowns, beside each set.
        squares: that nothing explains, beside those of the data.
        noise: standard deviation of the data; estimated unless given.
    """

    products: tuple[tuple[Products, ...], ...]
    counts: tuple[int, ...]
    squares: float
    noise: float | None

    @classmethod
    def of(
        cls,
        rows: Float[np.ndarray, "datum weight"],
        columns: Float[np.ndarray, "datum column"],
        beside: Sequence[Float[np.ndarray, "datum _"]],
        priors: Sequence[Matrix],
        *,
        squares: float,
        count: int,
        noise: float | None = None,
    ) -> "ColumnWeigher":
        """The products of all columns under each of several priors of the weights.

        Args:
            rows: $R$, the data of each weight.
            columns: the data without any force first, then columns to be weighed.
            beside: sets of columns with flat priors; each is weighed on its own, and
                the best one counts.
            count: of all data, less flat unknowns that are eliminated already.
        """
        products, counts = [], []
        for flat in map(_seen_directions, beside):
            reached, left = (part - flat @ (flat.T @ part) for part in (rows, columns))
            products.append(tuple(_products(reached, left, priors)))
            counts.append(count - flat.shape[1])
        return cls(tuple(products), tuple(counts), squares, noise)

    def fit(self, known: Columns = NONE, flat: Columns = NONE) -> ColumnFit:
        """The best fit of a hypothesis.

        Args:
            known: columns whose coefficient is one.
            flat: columns whose coefficients have a flat prior, one unit long.
        """
        sets = zip(self.products, self.counts, strict=True)
        fits = [
            self._fit(one, count - len(flat), known, flat)
            for products, count in sets
            for one in products
        ]
        return max(fits, key=lambda fit: fit.log_evidence)

    def _fit(
        self, products: Products, free: int, known: Columns, flat: Columns
    ) -> ColumnFit:
        grams = products.grams
        coefficients = np.zeros(grams.shape[1])
        coefficients[0] = coefficients[known] = 1.0
        pull = (grams @ coefficients)[:, flat]
        block = grams[:, flat[:, None], flat]
        values = -np.linalg.solve(block, pull[..., None])[..., 0]
        left = np.einsum("i,rij,j->r", coefficients, grams, coefficients)
        left = left + self.squares + np.sum(pull * values, axis=1)
        left = np.maximum(left, np.finfo(float).tiny)
        estimated = left / free
        variance = estimated if self.noise is None else 0 * left + self.noise**2
        log_evidence = -0.5 * (
            free * np.log(2 * np.pi * variance)
            + left / variance
            + products.log_determinants
            + np.linalg.slogdet(block)[1]
        )
        best = int(np.argmax(log_evidence))
        noise = float(np.sqrt(variance[best]))
        return ColumnFit(float(log_evidence[best]), noise, values[best])


def _products(
    rows: Float[np.ndarray, "datum weight"],
    columns: Float[np.ndarray, "datum column"],
    priors: Sequence[Matrix],
) -> Iterator[Products]:
    basis, square = np.linalg.qr(rows)
    inside = basis.T @ columns
    outside = columns - basis @ inside
    rest = outside.T @ outside
    for prior in priors:
        left, sizes, _ = np.linalg.svd(square @ root(prior))
        variances = np.zeros(len(left))
        variances[: len(sizes)] = sizes**2
        ratios = max(variances.max(initial=0.0), np.finfo(float).tiny) * RATIOS
        shares = ratios[:, None] / (variances + ratios[:, None])
        # Weighted columns: differences of products would lose half of the digits.
        weighted = np.sqrt(shares)[:, :, None] * (left.T @ inside)
        grams = np.swapaxes(weighted, 1, 2) @ weighted + rest
        yield Products(grams, -np.log(shares).sum(axis=1))


def _seen_directions(
    columns: Float[np.ndarray, "datum column"],
) -> Float[np.ndarray, "datum direction"]:
    """An orthonormal basis of what columns change in the data."""
    lengths = np.linalg.norm(columns, axis=0)
    columns = columns[:, lengths > 0] / lengths[lengths > 0]
    if not columns.shape[1]:
        return columns
    left, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, sizes > SEEN * sizes[0]]
