r"""Kernels, and the prior of their weights, that forces along observed paths ask for.

Exact data leave the force beside the paths to the prior. The evidence of the forces at
the samples, taken as known to a thousandth, chooses the length scale $\ell$, the
envelope and the amplitude $a$ of the covariance $a^2 K$ of the weights. With less noise
the errors of splines and of the kernels themselves would decide. What the mean of that
process leaves unexplained along the paths is the size of a white part, with which
trajectories can be followed to rounding: the covariance is $a^2 K + \tau^2 I$.

References:
    MacKay, Neural Computation 4, 415 (1992); Rasmussen and Williams, Gaussian
    Processes for Machine Learning (2006), chapter 5.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from pinav.arguments import on_device
from pinav.fitting.environments.force_regression import KernelKind, regress
from pinav.fitting.environments.kernels import (
    MOST_MATCHED,
    KernelGrid,
    num_weights,
    surround_with_kernels,
)
from pinav.fitting.environments.refinement import Refinement
from pinav.fitting.evidence.evidence import (
    Hyperparameters,
    LinearisedObservations,
    Whitened,
    best_hyperparameters,
    posterior_mean,
)
from pinav.forces import (
    AbstractLearnedForce,
    KernelForce,
    KernelPotential,
    LayeredPotential,
)
from pinav.forces.priors import Matrix

FIRST, FEWEST = 12, 4
"""Intervals of the first grid along the extent of the data, and of the coarsest one,
which is tried where finer ones have too many weights."""

NOISE = 1e-3
"""Of the forces, relative to their root mean square."""

WHITE = 3.0
"""Size of the white part, in units of the force that is left unexplained."""

LEAST_SINGULAR = 1e-6
"""Relative size of what the forces say of the weights that is worth keeping."""


class ForcePrior(eqx.Module):
    """The prior of an environment's weights by the forces at samples.

    Attributes:
        missed: error of the mean at the samples, relative to the forces.
        white: standard deviation of each weight beside the smooth process.
    """

    environment: AbstractLearnedForce
    chosen: Hyperparameters
    missed: float
    white: float

    @classmethod
    def of(
        cls,
        environment: AbstractLearnedForce,
        positions: Float[np.ndarray, "point dim"],
        forces: Float[np.ndarray, "point dim"],
    ) -> "ForcePrior":
        """Search for the prior of highest evidence.

        Args:
            positions: at which the force is known [L].
            forces: there [L T⁻²].
        """
        columns, targets = _regression(environment, positions, forces)
        size = _root_mean_square(targets) or 1.0
        data, prior = _independent(columns, targets), environment.prior()
        chosen = best_hyperparameters(data, prior, prior.start, NOISE * size)
        mean = posterior_mean(Whitened.of(data, prior.covariance(chosen.shape)), chosen)
        missed = _root_mean_square(columns @ mean - targets)
        return cls(environment, chosen, missed / size, _white(columns, missed))

    @property
    def suits(self) -> bool:
        """Whether the kernels are fine enough, and explain the forces."""
        asks = AS_FINE_AS_FORCES.is_needed(self.environment, self.chosen.shape)
        return not asks and self.missed < NOISE

    def root(self) -> Matrix:
        r"""$C$ with $C C^\top = a^2 K + \tau^2 I$, its columns from large to small."""
        smooth = self.environment.prior().covariance(self.chosen.shape)
        values, vectors = np.linalg.eigh(self.chosen.amplitude**2 * smooth)
        # A white part leaves room for what the smooth prior misses.
        variances = np.maximum(values, 0.0) + self.white**2
        return (vectors * np.sqrt(variances))[:, ::-1]


def layers_root(
    environment: LayeredPotential,
    positions: Float[np.ndarray, "point dim"],
    forces: Float[np.ndarray, "point dim"],
) -> Matrix:
    r"""A root of the prior of layers: weights of one layer are alike in size.

    A layer is as fine as its kernels, so that its weights need no length scale. Their
    standard deviations $s_l$ follow from the evidence by
    $s_l^2 \leftarrow \lVert m_l \rVert^2 / \gamma_l$, with the mean m of the weights
    and the number $\gamma_l$ of those that the forces determine.

    References:
        MacKay, Neural Computation 4, 415 (1992), eq. (21).
    """
    columns, targets = _regression(environment, positions, forces)
    noise = NOISE * _root_mean_square(targets) or 1.0
    rows = columns / noise
    normal, pull = rows.T @ rows, rows.T @ (targets / noise)
    counts = [num_weights(layer) for layer in environment.layers]
    layer = np.repeat(np.arange(len(counts)), counts)
    variances = np.full(len(layer), 1.0 / normal.diagonal().mean())
    mean = np.zeros_like(pull)
    for _ in range(LAYER_ROUNDS):
        covariance = np.linalg.inv(normal + np.diag(1.0 / variances))
        mean = covariance @ pull
        determined = 1.0 - covariance.diagonal() / variances
        squares, known = (np.bincount(layer, w) for w in (mean**2, determined))
        largest = squares.sum()
        variances = np.maximum(squares / known, LEAST_LAYER * largest)[layer]
    missed = _root_mean_square(columns @ mean - targets)
    return np.diag(np.sqrt(variances + _white(columns, missed) ** 2))


LAYER_ROUNDS, LEAST_LAYER = 12, 1e-20
"""Iterations, and the least variance of a layer relative to all squares."""


def _regression(
    environment: AbstractLearnedForce,
    positions: Float[np.ndarray, "point dim"],
    forces: Float[np.ndarray, "point dim"],
) -> tuple[Float[np.ndarray, "row weight"], Float[np.ndarray, " row"]]:
    """Columns of each weight, and what they are to explain."""
    with jax.enable_x64(new_val=True):
        columns = np.asarray(_columns(environment, on_device(positions)))
    return columns.reshape(-1, columns.shape[-1]), forces.reshape(-1)


def _white(columns: Float[np.ndarray, "row weight"], missed: float) -> float:
    """Standard deviation of weights which together make up for a missed force."""
    return WHITE * missed / float(np.sqrt(np.mean(np.sum(columns**2, axis=1))))


def _root_mean_square(values: Float[np.ndarray, "..."]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


AS_FINE_AS_FORCES = Refinement(max_weights=MOST_MATCHED, envelope=True)
"""Asks for finer kernels where length scale or envelope end at a width."""


def lay_smooth_kernels(
    kind: KernelKind,
    places: Float[np.ndarray, "place dim"],
    positions: Float[np.ndarray, "point dim"],
    forces: Float[np.ndarray, "point dim"],
) -> ForcePrior | None:
    """The coarsest kernels of one width that suit the forces; None if none do.

    Args:
        places: which the kernels surround [L].
    """
    rule, across = AS_FINE_AS_FORCES, float(FIRST)
    laid = _lay(kind, places, across)
    while num_weights(laid) > rule.max_weights and across > FEWEST:
        across /= rule.factor
        laid = _lay(kind, places, across)
    while num_weights(laid) <= rule.max_weights:
        if _explains(laid, positions, forces):
            prior = ForcePrior.of(laid, positions, forces)
            if prior.suits:
                return prior
        across *= rule.factor
        laid = _lay(kind, places, across)
    return None


def _explains(
    environment: AbstractLearnedForce,
    positions: Float[np.ndarray, "point dim"],
    forces: Float[np.ndarray, "point dim"],
) -> bool:
    """Whether any weights explain the forces, which no prior makes easier."""
    columns, targets = _regression(environment, positions, forces)
    weights = regress(columns.reshape(*forces.shape, -1), forces)
    missed = _root_mean_square(columns @ weights - targets)
    return missed <= NOISE * _root_mean_square(targets)


def _lay(
    kind: KernelKind, places: Float[np.ndarray, "place dim"], across: float
) -> KernelPotential | KernelForce:
    grid = KernelGrid(round(across))
    return kind.with_zero_weights(*surround_with_kernels(places, grid))


@eqx.filter_jit
def _columns(
    environment: AbstractLearnedForce, positions: Float[Array, "point dim"]
) -> Float[Array, "point dim weight"]:
    """Force of each weight at each position; compiled once for grids of one size."""
    weights, unravel = ravel_pytree(environment.parameters)

    def force(
        weights: Float[Array, " weight"], x: Float[Array, " dim"]
    ) -> Float[Array, " dim"]:
        filled = eqx.tree_at(lambda e: e.parameters, environment, unravel(weights))
        return filled(jnp.zeros(()), x, jnp.zeros_like(x))

    return jax.vmap(jax.jacrev(force), (None, 0))(weights, positions)


def _independent(
    columns: Float[np.ndarray, "row weight"], targets: Float[np.ndarray, " row"]
) -> LinearisedObservations:
    """The directions in which the forces tell something of the weights."""
    # Directions that the forces hardly see are left out: what they would tell is
    # rounding.
    left, sizes, right = np.linalg.svd(columns, full_matrices=False)
    kept = sizes > LEAST_SINGULAR * sizes[0]
    along = left[:, kept].T @ targets
    return LinearisedObservations(
        rows=sizes[kept, None] * right[kept],
        targets=along,
        squares=float(targets @ targets - along @ along),
        num_free=len(targets),
        log_determinant=0.0,
    )
