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
from jaxtyping import Bool, Float

from pinav.errors import FitError

LOG_RATIOS = np.linspace(-32.0, 4.0, 37)
r"""Logarithms of $\beta$ tried first, relative to the largest eigenvalue."""

ROOT_TOLERANCE = 1e-14
"""Variances that a root of the prior leaves out, relative to the largest."""


class Quadratic(eqx.Module):
    r"""Sum of squares about a point, and what it hides.

    $q + 2\,g\cdot\delta + \delta\cdot H\,\delta$ with $\delta = \theta - \theta_0$.
    About the origin it would be a small difference of large numbers.

    Attributes:
        point: $\theta_0$.
        hessian: $H$.
        gradient: $g$.
        squares: $q$.
        num_free: residuals less flat unknowns integrated out so far.
        log_determinant: of the blocks integrated out so far.
    """

    point: Float[np.ndarray, " parameter"]
    hessian: Float[np.ndarray, "parameter parameter"]
    gradient: Float[np.ndarray, " parameter"]
    squares: float
    num_free: int
    log_determinant: float


class FlatBlock(eqx.Module):
    """Parameters with a flat prior, given the weights.

    Attributes:
        mask: which of all parameters they are.
        offset: their values where the weights are zero.
        slope: their change per weight.
        covariance: their covariance given the weights, for unit noise.
    """

    mask: Bool[np.ndarray, " parameter"]
    offset: Float[np.ndarray, " flat"]
    slope: Float[np.ndarray, "flat weight"]
    covariance: Float[np.ndarray, "flat flat"]

    def map_weights(
        self,
    ) -> Float[np.ndarray, "parameter weight"]:
        """From changes of the weights to those of all parameters."""
        full = np.zeros((len(self.mask), self.slope.shape[1]))
        full[~self.mask] = np.eye(self.slope.shape[1])
        full[self.mask] = self.slope
        return full

    def lift(
        self, covariance: Float[np.ndarray, "weight weight"]
    ) -> Float[np.ndarray, "parameter parameter"]:
        """Covariance of all parameters that a covariance of the weights makes."""
        full = self.map_weights()
        return full @ covariance @ full.T


def without_flat(
    quadratic: Quadratic, mask: Bool[np.ndarray, " parameter"]
) -> tuple[Quadratic, FlatBlock]:
    """Integrate out the parameters in `mask`, which have a flat prior.

    Raises:
        FitError: the data do not determine them, even with the weights known.
    """
    hessian, gradient = quadratic.hessian, quadratic.gradient
    own, border = hessian[np.ix_(mask, mask)], hessian[np.ix_(mask, ~mask)]
    if is_singular(own):
        raise FitError(
            "the fit is singular: the data do not determine the learned constants; "
            "learn fewer of them"
        )
    covariance = np.linalg.inv(own)
    slope, change = -covariance @ border, -covariance @ gradient[mask]
    point = quadratic.point
    block = FlatBlock(
        mask=mask,
        offset=point[mask] + change - slope @ point[~mask],
        slope=slope,
        covariance=covariance,
    )
    reduced = Quadratic(
        point=point[~mask],
        hessian=hessian[np.ix_(~mask, ~mask)] + border.T @ slope,
        gradient=gradient[~mask] + border.T @ change,
        squares=quadratic.squares + float(gradient[mask] @ change),
        num_free=quadratic.num_free - int(mask.sum()),
        log_determinant=quadratic.log_determinant
        + float(np.linalg.slogdet(own).logabsdet),
    )
    return reduced, block


def is_singular(matrix: Float[np.ndarray, "n n"]) -> bool:
    """Whether a normal matrix, its rows and columns scaled, lost all digits."""
    scale = np.sqrt(np.diag(matrix))
    if not (np.all(np.isfinite(matrix)) and np.all(scale > 0)):
        return True
    if not scale.size:
        return False
    eigenvalues = np.linalg.eigvalsh(matrix / np.outer(scale, scale))
    return bool(eigenvalues[0] < 1e-13 * eigenvalues[-1])


class Data(eqx.Module):
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
    def of(cls, quadratic: Quadratic) -> "Data":
        """The data behind `quadratic`, less directions lost in rounding."""
        values, vectors = np.linalg.eigh(quadratic.hessian)
        kept = values > 1e-14 * values[-1]
        roots, vectors = np.sqrt(values[kept]), vectors[:, kept]
        residuals = vectors.T @ quadratic.gradient / roots
        return cls(
            rows=roots[:, None] * vectors.T,
            targets=roots * (vectors.T @ quadratic.point) - residuals,
            squares=quadratic.squares - float(residuals @ residuals),
            num_free=quadratic.num_free,
            log_determinant=quadratic.log_determinant,
        )


class _Whitened(eqx.Module):
    """The data in directions in which the prior makes them independent.

    Attributes:
        columns: from these directions to the weights, times their prior covariance.
        variances: prior variance in each direction, ascending.
        targets: the data there.
        squares: of the data in all other directions, which no weights reach.
    """

    columns: Float[np.ndarray, "weight direction"]
    variances: Float[np.ndarray, " direction"]
    targets: Float[np.ndarray, " direction"]
    squares: float

    @classmethod
    def of(cls, data: Data, prior: Float[np.ndarray, "weight weight"]):
        columns = root(prior)
        reached = data.rows @ columns
        if reached.shape[1] < reached.shape[0]:
            basis, square = np.linalg.qr(reached)
            own, singular, _ = np.linalg.svd(square)
            vectors, variances = (basis @ own)[:, ::-1], singular[::-1] ** 2
        else:
            variances, vectors = np.linalg.eigh(reached @ reached.T)
        targets = vectors.T @ data.targets
        missed = data.targets - vectors @ targets
        return cls(
            columns=columns @ (reached.T @ vectors),
            variances=np.maximum(variances, 0.0),
            targets=targets,
            squares=float(missed @ missed),
        )


def root(
    matrix: Float[np.ndarray, "weight weight"],
) -> Float[np.ndarray, "weight rank"]:
    r"""$C$ with $C C^\top$ the matrix: a long length scale needs few columns."""
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

    shape: Float[np.ndarray, " shape"]
    amplitude: float
    noise: float
    log_evidence: float


Covariance = Callable[[Float[np.ndarray, " shape"]], Float[np.ndarray, "weight weight"]]
"""Prior covariance of the weights for a shape, of unit amplitude."""

Slopes = Callable[
    [Float[np.ndarray, " shape"]], Float[np.ndarray, "shape weight weight"]
]
"""Its derivative by each entry of the shape."""


def best_hyperparameters(
    data: Data,
    covariance: Covariance,
    start: Float[np.ndarray, " shape"],
    bounds: Float[np.ndarray, "shape 2"],
    noise: float | None = None,
    slopes: Slopes | None = None,
) -> Hyperparameters:
    """The hyperparameters of highest evidence, by L-BFGS-B from `start`.

    Args:
        data: what the weights are to explain.
        covariance: prior of the weights.
        start: shape at which the search begins, each entry scaled to order one.
        bounds: between which each entry is sought.
        noise: standard deviation of the residuals; estimated unless given.
        slopes: derivatives of `covariance`; by differences of the evidence unless
            given.
    """
    if not len(start):
        return at_shape(data, covariance, start, noise)

    def loss(shape):
        chosen = at_shape(data, covariance, shape, noise)
        if slopes is None:
            return -chosen.log_evidence
        pull = covariance_pull(data, covariance(shape), chosen)
        gradient = -np.tensordot(slopes(shape), pull, axes=2)
        return -chosen.log_evidence, gradient

    from scipy.optimize import minimize  # 0.2 s that other fits do without

    found = minimize(
        loss,
        start,
        method="L-BFGS-B",
        jac=slopes is not None,
        bounds=bounds,
        options={"ftol": 1e-8, "gtol": 1e-3, "eps": 1e-4, "maxiter": 60},
    )
    return at_shape(data, covariance, found.x, noise)


def covariance_pull(
    data: Data,
    prior: Float[np.ndarray, "weight weight"],
    chosen: Hyperparameters,
) -> Float[np.ndarray, "weight weight"]:
    r"""Derivative of $\log Z$ by the entries of $K$, amplitude and noise held.

    $\tfrac12 R^\top (S^{-1}\tau\tau^\top S^{-1} \beta/\sigma^2 - S^{-1}) R$ with
    $S = R K R^\top + \beta$. At the best amplitude and noise that is the whole
    derivative of $\log Z$.

    References:
        Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), eq. 5.9.
    """
    ratio = (chosen.noise / chosen.amplitude) ** 2
    reached = data.rows @ root(prior)
    variances, vectors = np.linalg.eigh(reached @ reached.T)
    rows, targets = vectors.T @ data.rows, vectors.T @ data.targets
    shifted = np.maximum(variances, 0.0) + ratio
    pulled = (targets / shifted) @ rows / chosen.amplitude
    scaled = rows / np.sqrt(shifted)[:, None]
    return 0.5 * (np.outer(pulled, pulled) - scaled.T @ scaled)


def at_shape(
    data: Data,
    covariance: Covariance,
    shape: Float[np.ndarray, " shape"],
    noise: float | None = None,
) -> Hyperparameters:
    """Amplitude, and noise unless given, of highest evidence for this shape."""
    from scipy.optimize import minimize_scalar

    white = _Whitened.of(data, covariance(shape))
    largest = max(white.variances[-1], np.finfo(float).tiny)

    def loss(log_ratio):
        return -_log_evidence(data, white, largest * np.exp(log_ratio), noise)[0]

    coarse = LOG_RATIOS[np.argmin([loss(value) for value in LOG_RATIOS])]
    step = LOG_RATIOS[1] - LOG_RATIOS[0]
    found = minimize_scalar(
        loss,
        bounds=(coarse - step, coarse + step),
        method="bounded",
        options={"xatol": 1e-5},
    )
    ratio = largest * np.exp(found.x)
    value, variance = _log_evidence(data, white, ratio, noise)
    return Hyperparameters(
        shape=np.asarray(shape),
        amplitude=float(np.sqrt(variance / ratio)),
        noise=float(np.sqrt(variance)) if noise is None else noise,
        log_evidence=float(value),
    )


def log_evidence(
    data: Data,
    prior: Float[np.ndarray, "weight weight"],
    amplitude: float,
    noise: float,
) -> float:
    """Log evidence of given hyperparameters.

    Args:
        data: what the weights are to explain.
        prior: covariance of the weights for unit amplitude.
        amplitude: of the prior.
        noise: standard deviation of the residuals.
    """
    white = _Whitened.of(data, prior)
    return float(_log_evidence(data, white, (noise / amplitude) ** 2, noise)[0])


def _log_evidence(data, white, ratio, noise):
    r"""Log evidence for $\beta$ = `ratio`, and the variance $\sigma^2$."""
    shifted = white.variances + ratio
    explained = ratio * float(white.targets @ (white.targets / shifted))
    least = np.finfo(float).eps * float(data.targets @ data.targets) ** 0.5
    squares = max(data.squares, 0.0) + white.squares + explained
    squares = max(squares, least**2, np.finfo(float).tiny)
    variance = squares / data.num_free if noise is None else noise**2
    value = -0.5 * (
        data.num_free * np.log(2 * np.pi * variance)
        + squares / variance
        + np.log(shifted / ratio).sum()
        + data.log_determinant
    )
    return value, variance


def weight_posterior(
    data: Data,
    prior: Float[np.ndarray, "weight weight"],
    chosen: Hyperparameters,
) -> tuple[Float[np.ndarray, " weight"], Float[np.ndarray, "weight weight"]]:
    r"""Mean and covariance of the weights, $(H/\sigma^2 + K^{-1}/a^2)^{-1}$."""
    white = _Whitened.of(data, prior)
    shifted = white.variances + (chosen.noise / chosen.amplitude) ** 2
    mean = white.columns @ (white.targets / shifted)
    learned = (white.columns / shifted) @ white.columns.T
    return mean, chosen.amplitude**2 * (prior - learned)


def shape_covariance(
    data: Data,
    covariance: Covariance,
    chosen: Hyperparameters,
    noise: float | None = None,
) -> Float[np.ndarray, "weight weight"]:
    r"""What the uncertainty of the prior's shape adds to the weights' covariance.

    $M A^{-1} M^\top$: see `shape_changes`.
    """
    changes = shape_changes(data, covariance, chosen, noise)
    return changes @ changes.T


def shape_changes(
    data: Data,
    covariance: Covariance,
    chosen: Hyperparameters,
    noise: float | None = None,
) -> Float[np.ndarray, "weight shape"]:
    r"""Changes of the mean by independent standard deviations of the prior's shape.

    $M A^{-1/2}$ with the curvature $A$ of $-\log Z$ and the slope $M$ of the mean,
    both by differences. A normal distribution of standard deviation `SHAPE_SD` holds
    directions of the shape on which the evidence does not depend.

    References:
        MacKay, Neural Computation 11, 1035 (1999), section 5.
    """
    if not len(chosen.shape):
        return np.zeros((data.rows.shape[1], 0))
    unit = STEP * np.eye(len(chosen.shape))

    def at(offset):
        return at_shape(data, covariance, chosen.shape + offset, noise)

    def mean(offset):
        shape = chosen.shape + offset
        return weight_posterior(data, covariance(shape), at(offset))[0]

    bend = curvature(lambda shape: at(shape).log_evidence, np.zeros(len(unit)), STEP)
    values, vectors = np.linalg.eigh(bend)
    spread = vectors / np.sqrt(np.maximum(values, 0.0) + SHAPE_SD**-2)
    slopes = np.stack([(mean(a) - mean(-a)) / (2 * STEP) for a in unit], axis=1)
    return slopes @ spread


def curvature(
    value: Callable[[Float[np.ndarray, " n"]], float],
    point: Float[np.ndarray, " n"],
    step: float,
) -> Float[np.ndarray, "n n"]:
    """Hessian of minus a function, by central differences.

    Args:
        value: the function; it is called n (n + 1) + 1 times.
        point: where.
        step: of the differences.
    """
    steps = step * np.eye(len(point))
    middle = value(point)
    sums = np.array([value(point + s) + value(point - s) - 2 * middle for s in steps])
    hessian = np.diag(sums)
    for i, j in zip(*np.triu_indices(len(point), 1), strict=True):
        both = value(point + steps[i] + steps[j]) + value(point - steps[i] - steps[j])
        mixed = 0.5 * (both - 2 * middle - sums[i] - sums[j])
        hessian[i, j] = hessian[j, i] = mixed
    return -hessian / step**2


STEP, SHAPE_SD = 1e-3, 2.0
"""Difference step in the shape, and standard deviation of its own prior.

Where the length scale is huge the reach R is known to some 4e-4; a step ten times as
long misses that curvature, and the bands become too narrow.
"""


def joint_posterior(
    block: FlatBlock,
    mean: Float[np.ndarray, " weight"],
    covariance: Float[np.ndarray, "weight weight"],
    noise: float,
) -> tuple[Float[np.ndarray, " parameter"], Float[np.ndarray, "parameter parameter"]]:
    """Mean and covariance of all parameters from those of the weights."""
    joint, mask = block.lift(covariance), block.mask
    joint[np.ix_(mask, mask)] += noise**2 * block.covariance
    offset = np.zeros(len(mask))
    offset[mask] = block.offset
    return offset + block.map_weights() @ mean, joint
