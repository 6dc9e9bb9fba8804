r"""The evidence of a linear model with a Gaussian prior, and its best hyperparameters.

Residuals are normal with standard deviation $\sigma$. The weights $w$ have the prior
$N(0, a^2 K)$; all other unknowns have a flat one and are integrated out, so that
$\sigma$ is not estimated too small (restricted likelihood). With $C C^\top = K$,
$\beta = \sigma^2/a^2$ and the eigenvalues $e_i$ of $C^\top H C$,

$$-2 \log Z = n \log 2\pi\sigma^2 + m(\beta)/\sigma^2
  + \sum_i \log(1 + e_i/\beta) + \log\det,$$

where $m$ is the least regularised sum of squares, $n$ the number of residuals less the
number of flat unknowns and det the determinant of what was integrated out.

References:
    MacKay, Neural Computation 4, 415 (1992); Rasmussen and Williams, Gaussian
    Processes for Machine Learning (2006), chapter 5; Patterson and Thompson,
    Biometrika 58, 545 (1971).
"""

from collections.abc import Callable

import equinox as eqx
import numpy as np
import scipy.linalg
from jaxtyping import Float

from pinav.errors import FitError
from pinav.fitting.evidence.quadratic import Quadratic
from pinav.forces.priors import AbstractPrior, Matrix, Shape

Numbers = float | np.ndarray
"""One number, or several."""

LOG_RATIOS = np.linspace(-32.0, 4.0, 37)
r"""Logarithms of $\beta$ tried first, relative to the largest eigenvalue."""

ROOT_TOLERANCE = 1e-14
"""Variances that a root of the prior leaves out, relative to the largest."""


LEAST_VARIANCE = 1e-100
"""What variances of the prior count as at least, so that their ratios to that of the
noise stay within the machine's numbers."""


class LinearisedObservations(eqx.Module):
    r"""The quadratic as few independent data, $|R w - \tau|^2 + q_0$.

    Attributes:
        rows: $R$, one for each direction that the data determine at all.
        targets: $\tau$.
        squares: $q_0$, which no weights explain.
        num_free: residuals less flat unknowns.
        log_determinant: of what was integrated out.
    """

    rows: Float[np.ndarray, "datum weight"]
    targets: Float[np.ndarray, " datum"]
    squares: float
    num_free: int
    log_determinant: float

    @classmethod
    def of(cls, quadratic: Quadratic) -> "LinearisedObservations":
        """The data behind `quadratic`, less directions lost in rounding."""
        values, vectors = np.linalg.eigh(quadratic.hessian)
        # Below this share eigenvalues are rounding; their directions the data do not
        # see.
        kept = values > 1e-14 * values[-1]
        if not kept.any():
            raise FitError(
                "the fit is singular: the observations do not depend on the weights of "
                "the environment; its kernels are not where the states are, or the "
                "states have left them"
            )
        roots, vectors = np.sqrt(values[kept]), vectors[:, kept]
        residuals = vectors.T @ quadratic.gradient / roots
        return cls(
            rows=roots[:, None] * vectors.T,
            targets=roots * (vectors.T @ quadratic.point) - residuals,
            squares=quadratic.squares - float(residuals @ residuals),
            num_free=quadratic.num_free,
            log_determinant=quadratic.log_determinant,
        )

    @property
    def log_evidence_without(self) -> float:
        """Log evidence where all weights are zero; the noise is estimated."""
        squares = max(self.squares, 0.0) + float(self.targets @ self.targets)
        variance = max(squares / self.num_free, np.finfo(float).tiny)
        logarithm = np.log(2 * np.pi * variance) + 1.0
        return -0.5 * float(self.num_free * logarithm + self.log_determinant)


class Whitened(eqx.Module):
    r"""The data in directions in which the prior makes them independent.

    Attributes:
        columns: $C$, a root of the prior.
        reached: $R C$, the data of each of its columns.
        vectors: the directions, orthonormal.
        variances: prior variance in each direction, ascending.
        targets: the data there.
        missed: the data in all other directions, which no weights reach.
    """

    columns: Float[np.ndarray, "weight column"]
    reached: Float[np.ndarray, "datum column"]
    vectors: Float[np.ndarray, "datum direction"]
    variances: Float[np.ndarray, " direction"]
    targets: Float[np.ndarray, " direction"]
    missed: Float[np.ndarray, " datum"]

    @classmethod
    def of(cls, data: LinearisedObservations, prior: Matrix) -> "Whitened":
        """The data under a prior covariance of the weights."""
        columns = root(prior)
        reached = data.rows @ columns
        if reached.shape[1] < reached.shape[0]:
            # A QR first: the singular values then come from the small square, and
            # squares of singular values keep digits that the eigenvalues of a product
            # lose.
            basis, square = np.linalg.qr(reached)
            rotation, singular, _ = np.linalg.svd(square)
            vectors, variances = (basis @ rotation)[:, ::-1], singular[::-1] ** 2
        else:
            variances, vectors = np.linalg.eigh(reached @ reached.T)
        targets = vectors.T @ data.targets
        return cls(
            columns=columns,
            reached=reached,
            vectors=vectors,
            variances=np.maximum(variances, 0.0),
            targets=targets,
            missed=data.targets - vectors @ targets,
        )

    def to_weights(
        self, values: Float[np.ndarray, " direction *all"]
    ) -> Float[np.ndarray, " weight *all"]:
        """What values in the directions are of the weights, by their covariance."""
        return self.columns @ (self.reached.T @ (self.vectors @ values))


def root(matrix: Matrix) -> Float[np.ndarray, "weight rank"]:
    r"""$C$ with $C C^\top$ the matrix: a long length scale needs few columns."""
    # Pivoting lets the factor stop at the numerical rank of a smooth covariance.
    least = ROOT_TOLERANCE * matrix.diagonal().max()
    (pivoted_cholesky,) = scipy.linalg.get_lapack_funcs(("pstrf",), (matrix,))
    factor, pivots, rank, _ = pivoted_cholesky(matrix, lower=1, tol=least)
    root = np.empty((len(matrix), rank))
    root[pivots - 1] = np.tril(factor)[:, :rank]
    return root


class Hyperparameters(eqx.Module):
    r"""What the evidence chooses.

    Attributes:
        shape: what the prior's covariance $K$ depends on.
        amplitude: $a$ of the prior, in the unit of the weights.
        noise: $\sigma$.
        log_evidence: $\log Z$.
    """

    shape: Shape
    amplitude: float
    noise: float
    log_evidence: float


def best_hyperparameters(
    data: LinearisedObservations,
    prior: AbstractPrior,
    start: Shape,
    noise: float | None = None,
    tolerance: float = 1e-8,
) -> Hyperparameters:
    """The hyperparameters of highest evidence, by L-BFGS-B from `start`.

    Args:
        start: shape at which the search begins, each entry scaled to order one.
        noise: standard deviation of the residuals; estimated unless given.
        tolerance: change of the log evidence, relative to it, at which the search ends.
    """
    if not len(start):
        return at_shape(data, prior.covariance, start, noise)

    def loss(shape: Shape) -> tuple[float, Shape]:
        white = Whitened.of(data, prior.covariance(shape))
        chosen = best_amplitude(data, white, shape, noise)
        return -chosen.log_evidence, -shape_slope(data, white, chosen, prior)

    from scipy.optimize import minimize  # 0.2 s that other fits do without

    search = minimize(
        loss,
        start,
        method="L-BFGS-B",
        jac=True,
        bounds=prior.bounds,
        options={"ftol": tolerance, "gtol": 1e-3, "maxiter": 60},
    )
    return at_shape(data, prior.covariance, search.x, noise)


def shape_slope(
    data: LinearisedObservations,
    white: Whitened,
    chosen: Hyperparameters,
    prior: AbstractPrior,
) -> Shape:
    r"""Derivative of $\log Z$ by the shape, at its best amplitude and noise.

    By the entries of $K$, amplitude and noise held, it is
    $\tfrac12 R^\top (S^{-1}\tau\tau^\top S^{-1} \beta/\sigma^2 - S^{-1}) R$ with
    $S = R K R^\top + \beta$. At the best amplitude and noise that is the whole
    derivative of $\log Z$.

    Args:
        white: the data under the prior of this shape.

    References:
        Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), eq. 5.9.
    """
    ratio = (chosen.noise / chosen.amplitude) ** 2
    shifted = white.variances + ratio
    rows = white.vectors.T @ data.rows
    scaled = rows / np.sqrt(shifted)[:, None]
    pulled, held = (white.targets / shifted) @ rows, scaled.T @ scaled
    if white.vectors.shape[1] < len(data.rows):
        unreached = data.rows - white.vectors @ rows
        # What no weight reaches is known to the noise alone.
        pulled += white.missed @ unreached / ratio
        held += unreached.T @ unreached / ratio
    pulled /= chosen.amplitude
    return prior.pullback(chosen.shape, 0.5 * (np.outer(pulled, pulled) - held))


def at_shape(
    data: LinearisedObservations,
    covariance: Callable[[Shape], Matrix],
    shape: Shape,
    noise: float | None = None,
) -> Hyperparameters:
    """Amplitude, and noise unless given, of highest evidence for this shape.

    Args:
        covariance: of the weights for a shape, for unit amplitude.
    """
    white = Whitened.of(data, covariance(shape))
    return best_amplitude(data, white, shape, noise)


def best_amplitude(
    data: LinearisedObservations,
    white: Whitened,
    shape: Shape,
    noise: float | None = None,
) -> Hyperparameters:
    """As `at_shape`, for data that are whitened already."""
    from scipy.optimize import minimize_scalar

    # None are left where a narrow envelope is so far away that it underflows.
    largest = max(white.variances.max(initial=0.0), LEAST_VARIANCE)

    by_ratio = _by_ratio(data, white)

    def loss(log_ratio: float) -> float:
        return -float(by_ratio(largest * np.exp(log_ratio), noise)[0])

    # The evidence may have several maxima in the ratio: a scan first, then the best.
    scan, _ = by_ratio(largest * np.exp(LOG_RATIOS), noise)
    coarse = LOG_RATIOS[np.argmax(scan)]
    step = LOG_RATIOS[1] - LOG_RATIOS[0]
    search = minimize_scalar(
        loss,
        bounds=(coarse - step, coarse + step),
        method="bounded",
        options={"xatol": 1e-7},
    )
    ratio = largest * np.exp(search.x)
    value, variance = by_ratio(ratio, noise)
    return Hyperparameters(
        shape=np.asarray(shape),
        amplitude=float(np.sqrt(variance / ratio)),
        noise=float(np.sqrt(variance)) if noise is None else noise,
        log_evidence=float(value),
    )


def evidence_of_scales(
    data: LinearisedObservations, prior: Matrix
) -> Callable[[float, float], float]:
    """Log evidence as a function of the amplitude of the prior and the noise.

    Nearly all of the work is that of the prior. What is kept of it is small.

    Args:
        prior: covariance of the weights for unit amplitude.
    """
    by_ratio = _by_ratio(data, Whitened.of(data, prior))

    def at(amplitude: float, noise: float) -> float:
        return float(by_ratio((noise / amplitude) ** 2, noise)[0])

    return at


def _by_ratio(
    data: LinearisedObservations, white: Whitened
) -> Callable[[Numbers, float | None], tuple[Numbers, Numbers]]:
    r"""Log evidence, and the variance $\sigma^2$, by the ratio $\beta$ and the noise.

    Thousands of ratios are tried in a fit; what does not depend on them is computed
    once, and several ratios at a time. The noise is estimated where it is None.
    """
    variances, targets, count = white.variances, white.targets, data.num_free
    rest = max(data.squares, 0.0) + float(white.missed @ white.missed)
    # Squares below rounding are no evidence of less noise.
    least = np.finfo(float).eps * float(data.targets @ data.targets) ** 0.5
    floor, log_determinant = max(least**2, np.finfo(float).tiny), data.log_determinant

    def at(ratio: Numbers, noise: float | None) -> tuple[Numbers, Numbers]:
        ratio = np.asarray(ratio)
        shifted = variances + ratio[..., None]
        explained = ratio * ((targets / shifted) @ targets)
        squares = np.maximum(rest + explained, floor)
        variance = squares / count if noise is None else np.float64(noise) ** 2
        value = -0.5 * (
            count * np.log(2 * np.pi * variance)
            + squares / variance
            + np.log(shifted / ratio[..., None]).sum(axis=-1)
            + log_determinant
        )
        return value, variance

    return at


def weight_posterior(
    data: LinearisedObservations, prior: Matrix, chosen: Hyperparameters
) -> tuple[Float[np.ndarray, " weight"], Matrix]:
    r"""Mean and covariance of the weights, $(H/\sigma^2 + K^{-1}/a^2)^{-1}$."""
    white = Whitened.of(data, prior)
    shifted = white.variances + (chosen.noise / chosen.amplitude) ** 2
    columns = white.to_weights(np.eye(len(shifted)))
    learned = (columns / shifted) @ columns.T
    # The prior less what was learned: directions that no datum sees keep their
    # variance.
    return posterior_mean(white, chosen), chosen.amplitude**2 * (prior - learned)


def posterior_mean(
    white: Whitened, chosen: Hyperparameters
) -> Float[np.ndarray, " weight"]:
    """Mean of the weights, for data that are whitened already."""
    shifted = white.variances + (chosen.noise / chosen.amplitude) ** 2
    return white.to_weights(white.targets / shifted)
