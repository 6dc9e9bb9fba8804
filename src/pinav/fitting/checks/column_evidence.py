r"""Evidence of hypotheses that add known columns to a field of kernels.

Data $y$ are explained by kernels with a Gaussian prior, by columns whose coefficients
are normal, of deviation one, and by columns whose coefficient is known. With $R$ the
data of each weight, $K$ the prior and $S = 1 + R K R^\top / \beta$ the covariance in
units of the noise $\sigma^2$, the evidence of a hypothesis with the residuals $r$ of
its known columns and the normal columns $F$ is

$$-2 \log Z = n \log 2\pi\sigma^2 + q / \sigma^2 + \log\det S
  + \log\det(1 + F^\top S^{-1} F / \sigma^2),$$
$$q = r^\top S^{-1} r
  - r^\top S^{-1} F (\sigma^2 + F^\top S^{-1} F)^{-1} F^\top S^{-1} r.$$

All of this follows from the products $A^\top S^{-1} A$ of all columns, data included,
so that one eigenvalue problem a prior serves any number of hypotheses.

A prior that is wrong, of a field with edges, makes columns likely that are nothing:
they repair the fit where it fails. What is true of all data predicts each trajectory
from the others (`predictions`): with the blocks $B$ of $S^{-1}$ and the residuals
$e = S^{-1} r$ of a trajectory its density, given all others, is
$-2 \log p = n \log 2\pi\sigma^2 - \log\det B + e^\top B^{-1} e / \sigma^2$.

References:
    Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), sections 2.7
    and 5.4.2; Patterson and Thompson, Biometrika 58, 545 (1971).
"""

from collections.abc import Iterator, Sequence

import equinox as eqx
import numpy as np
import scipy.linalg
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


class Products(eqx.Module):
    r"""Products of all columns under one prior, for several ratios $\beta$.

    Attributes:
        beside: directions of columns with flat priors, which are projected out.
        grams: $A^\top S^{-1} A$.
        log_determinants: of $S$.
    """

    beside: Float[np.ndarray, "datum direction"]
    root: Float[np.ndarray, "weight rank"]
    ratios: Float[np.ndarray, " ratio"]
    grams: Float[np.ndarray, "ratio column column"]
    log_determinants: Float[np.ndarray, " ratio"]


class ColumnFit(eqx.Module):
    r"""The best fit of a hypothesis.

    Attributes:
        values: of the normal coefficients.
        coefficients: of all columns.
        products: under the prior that is best for it.
        ratio: $\beta$ that is best for it.
    """

    log_evidence: float
    noise: float
    values: Float[np.ndarray, " normal"]
    coefficients: Float[np.ndarray, " column"]
    products: Products
    ratio: float


class ColumnWeigher(eqx.Module):
    """The evidence of columns beside kernels.

    Attributes:
        rows: $R$, the data of each weight.
        columns: the data without any force first, then columns to be weighed.
        products: of each set of columns that stand beside the kernels, and each prior.
        count: of all data, less flat unknowns that are eliminated already.
        squares: that nothing explains, beside those of the data.
        noise: standard deviation of the data; estimated unless given.
    """

    rows: Float[np.ndarray, "datum weight"]
    columns: Float[np.ndarray, "datum column"]
    products: tuple[Products, ...]
    count: int
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
            beside: sets of columns with flat priors; each is weighed on its own, and
                the best one counts.
        """
        sets = map(_seen_directions, beside)
        products = [
            one for flat in sets for one in _products(rows, columns, flat, priors)
        ]
        return cls(rows, columns, tuple(products), count, squares, noise)

    def fit(self, known: Columns = NONE, normal: Columns = NONE) -> ColumnFit:
        """The best fit of a hypothesis.

        Args:
            known: columns whose coefficient is one.
            normal: columns whose coefficients are normal, of deviation one.
        """
        fits = [self._fit(one, known, normal) for one in self.products]
        return max(fits, key=lambda fit: fit.log_evidence)

    def _fit(self, products: Products, known: Columns, normal: Columns) -> ColumnFit:
        grams, free = products.grams, self.count - products.beside.shape[1]
        coefficients = np.zeros(grams.shape[1])
        coefficients[0] = coefficients[known] = 1.0
        pull = (grams @ coefficients)[:, normal]
        block, unit = grams[:, normal[:, None], normal], np.eye(len(normal))
        whole = np.einsum("i,rij,j->r", coefficients, grams, coefficients)
        left = whole = np.maximum(whole + self.squares, np.finfo(float).tiny)
        values = np.zeros((len(left), len(normal)))
        # The prior of a coefficient counts in units of the noise, which it changes:
        # first the noise beside a flat prior.
        held = LEAST_SHARE * np.trace(block, axis1=1, axis2=2)
        for _ in range(ROUNDS if len(normal) else 0):
            solved = np.linalg.solve(
                block + held[:, None, None] * unit, pull[..., None]
            )
            values = -solved[..., 0]
            left = np.maximum(whole + np.sum(pull * values, axis=1), 1e-300)
            held = self._variance(left / free)
        variance = self._variance(left / free)
        log_evidence = -0.5 * (
            free * np.log(2 * np.pi * variance)
            + left / variance
            + products.log_determinants
            + np.linalg.slogdet(unit + block / variance[:, None, None])[1]
        )
        best = int(np.argmax(log_evidence))
        coefficients[normal] = values[best]
        return ColumnFit(
            log_evidence=float(log_evidence[best]),
            noise=float(np.sqrt(variance[best])),
            values=values[best],
            coefficients=coefficients,
            products=products,
            ratio=float(products.ratios[best]),
        )

    def _variance(
        self, estimated: Float[np.ndarray, " ratio"]
    ) -> Float[np.ndarray, " ratio"]:
        """The variance of the noise at each ratio: the estimated one unless known."""
        if self.noise is None:
            return estimated
        return np.full_like(estimated, self.noise**2)

    def predictions(
        self, fit: ColumnFit, trajectories: int
    ) -> Float[np.ndarray, " trajectory"]:
        """Log density of each trajectory, given all others.

        Args:
            trajectories: among which the data are divided equally.
        """
        flat = fit.products.beside
        reached = self.rows @ (fit.products.root / np.sqrt(fit.ratio))
        # What has a flat prior has one that is wide here.
        reached = np.hstack([reached, WIDE * np.linalg.norm(reached) * flat])
        factor = np.linalg.cholesky(np.eye(reached.shape[1]) + reached.T @ reached)
        whole = scipy.linalg.solve_triangular(factor, reached.T, lower=True)
        targets = self.columns @ fit.coefficients
        residuals = targets - whole.T @ (whole @ targets)
        densities = []
        parts = np.split(whole, trajectories, axis=1)
        each = zip(parts, np.split(residuals, trajectories), strict=True)
        for part, left in each:
            values, vectors = np.linalg.eigh(np.eye(len(left)) - part.T @ part)
            values = np.maximum(values, LEAST_SHARE)
            squares = float(np.sum((vectors.T @ left) ** 2 / values)) / fit.noise**2
            logarithms = len(left) * np.log(2 * np.pi * fit.noise**2)
            densities.append(-0.5 * (logarithms - np.log(values).sum() + squares))
        return np.array(densities)


ROUNDS = 3
"""Estimates of coefficients, whose prior counts in units of the noise beside them."""

WIDE = 1e4
"""Deviation of a coefficient with a flat prior, relative to those of the kernels."""

LEAST_SHARE = 1e-9
"""Share of what data tell that is rounding."""


def _products(
    rows: Float[np.ndarray, "datum weight"],
    columns: Float[np.ndarray, "datum column"],
    flat: Float[np.ndarray, "datum direction"],
    priors: Sequence[Matrix],
) -> Iterator[Products]:
    rows, columns = (part - flat @ (flat.T @ part) for part in (rows, columns))
    basis, square = np.linalg.qr(rows)
    inside = basis.T @ columns
    outside = columns - basis @ inside
    rest = outside.T @ outside
    for prior in priors:
        factor = root(prior)
        left, sizes, _ = np.linalg.svd(square @ factor)
        variances = np.zeros(len(left))
        variances[: len(sizes)] = sizes**2
        ratios = max(variances.max(initial=0.0), np.finfo(float).tiny) * RATIOS
        shares = ratios[:, None] / (variances + ratios[:, None])
        # Weighted columns: differences of products would lose half of the digits.
        weighted = np.sqrt(shares)[:, :, None] * (left.T @ inside)
        grams = np.swapaxes(weighted, 1, 2) @ weighted + rest
        yield Products(flat, factor, ratios, grams, -np.log(shares).sum(axis=1))


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
