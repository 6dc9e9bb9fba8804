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
from pinav.fitting.environments.force_regression import KernelKind
from pinav.fitting.environments.kernels import (
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
from pinav.forces import AbstractLearnedForce, KernelForce, KernelPotential
from pinav.forces.priors import Matrix

FIRST, FEWEST = 12, 4
"""Intervals of the first grid along the extent of the data, and of the coarsest one,
which is tried where finer ones have too many weights."""

MOST_SEARCHED = 500
"""Weights beyond which a search for the shape of their prior would take minutes where
kernels have several widths; the shape at which a search begins is then taken."""

NOISE = 1e-3
"""Of the forces, relative to their root mean square."""

WHITE = 3.0
"""Size of the white part, in units of the force that is left unexplained."""

LEAST_SINGULAR = 1e-6
"""Relative size of what the forces say of the weights that is worth keeping."""


class ForcePrior(eqx.Module):
    """The prior of an environment's weights by the forces at samples.

    Attributes:
        environment: untrained, linear in its weights.
        chosen: hyperparameters of highest evidence.
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
            environment: linear in its weights.
            positions: at which the force is known [L].
            forces: there [L T⁻²].
        """
        with jax.enable_x64(new_val=True):
            columns = np.asarray(_columns(environment, on_device(positions)))
        columns = columns.reshape(-1, columns.shape[-1])
        targets = forces.reshape(-1)
        size = float(np.sqrt(np.mean(targets**2))) or 1.0
        data, prior = _independent(columns, targets), environment.prior()
        start, bounds = prior.start, prior.bounds
        if columns.shape[1] > MOST_SEARCHED and len(start) > environment.dim + 2:
            bounds = np.stack([start, start], axis=1)
        chosen = best_hyperparameters(
            data, prior.covariance, start, bounds, NOISE * size, prior.slopes
        )
        mean = posterior_mean(Whitened.of(data, prior.covariance(chosen.shape)), chosen)
        missed = float(np.sqrt(np.mean(np.square(columns @ mean - targets))))
        each = float(np.sqrt(np.mean(np.sum(columns**2, axis=1))))
        return cls(environment, chosen, missed / size, WHITE * missed / each)

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


AS_FINE_AS_FORCES = Refinement(max_weights=900, envelope=True)
"""Asks for finer kernels where length scale or envelope end at a width."""


def lay_smooth_kernels(
    kind: KernelKind,
    places: Float[np.ndarray, "place dim"],
    positions: Float[np.ndarray, "point dim"],
    forces: Float[np.ndarray, "point dim"],
) -> ForcePrior | None:
    """The coarsest kernels of one width that suit the forces; None if none do.

    Args:
        kind: of the kernels.
        places: which the kernels surround [L].
        positions: at which the force is known [L].
        forces: there [L T⁻²].
    """
    rule, across = AS_FINE_AS_FORCES, float(FIRST)
    laid = _lay(kind, places, across)
    while num_weights(laid) > rule.max_weights and across > FEWEST:
        across /= rule.factor
        laid = _lay(kind, places, across)
    while num_weights(laid) <= rule.max_weights:
        prior = ForcePrior.of(laid, positions, forces)
        if prior.suits:
            return prior
        across *= rule.factor
        laid = _lay(kind, places, across)
    return None


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
