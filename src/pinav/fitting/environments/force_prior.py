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

from pinav.fitting.environments.kernels import KernelGrid, surround_with_kernels
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

Kinds = type[KernelPotential] | type[KernelForce]

FIRST, FINER = 12, 1.5
"""Intervals of the first grid along the extent of the data; factor to the next one."""

FEWEST = 4
"""Intervals of the coarsest grid that is tried, where finer ones have too many
weights."""

MOST_WEIGHTS = 900
"""Weights of kernels that are laid, at most."""

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
        columns = _columns(environment, positions)
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
        variances = np.maximum(values, 0.0) + self.white**2
        return (vectors * np.sqrt(variances))[:, ::-1]


AS_FINE_AS_FORCES = Refinement(envelope=True)
"""Asks for finer kernels where length scale or envelope end at a width."""


def lay_smooth_kernels(
    kind: Kinds,
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
    across = float(FIRST)
    while _num_weights(kind, places, across) > MOST_WEIGHTS and across > FEWEST:
        across /= FINER
    while _num_weights(kind, places, across) <= MOST_WEIGHTS:
        laid = kind.with_zero_weights(*_lay(places, across))
        prior = ForcePrior.of(laid, positions, forces)
        if prior.suits:
            return prior
        across *= FINER
    return None


def _num_weights(
    kind: Kinds, places: Float[np.ndarray, "place dim"], across: float
) -> int:
    return int(np.prod(kind.weight_shape(np.shape(_lay(places, across)[0]))))


def _lay(
    places: Float[np.ndarray, "place dim"], across: float
) -> tuple[Float[np.ndarray, "kernel dim"], float]:
    return surround_with_kernels(places, KernelGrid(round(across)))


def _columns(
    environment: AbstractLearnedForce, positions: Float[np.ndarray, "point dim"]
) -> Float[np.ndarray, "row weight"]:
    """Force of each weight at each position, its components one after the other."""
    weights, unravel = ravel_pytree(environment.parameters)

    def force(
        weights: Float[Array, " weight"], x: Float[Array, " dim"]
    ) -> Float[Array, " dim"]:
        made = eqx.tree_at(lambda e: e.parameters, environment, unravel(weights))
        return made(jnp.zeros(()), x, jnp.zeros_like(x))

    with jax.enable_x64(new_val=True):
        of_all = jax.jit(jax.vmap(jax.jacrev(force), (None, 0)))
        columns = np.asarray(of_all(weights, jnp.asarray(positions)))
    return columns.reshape(-1, columns.shape[-1])


def _independent(
    columns: Float[np.ndarray, "row weight"], targets: Float[np.ndarray, " row"]
) -> LinearisedObservations:
    """The directions in which the forces tell something of the weights."""
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
