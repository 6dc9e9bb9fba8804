r"""Kernels, and the prior of their weights, that forces along observed paths ask for.

Exact data leave the force beside the paths to the prior. The evidence of the forces at
the samples, taken as known to a thousandth, chooses the length scale $\ell$, the
envelope and the amplitude $a$ of the covariance $a^2 K$ of the weights, and how fine
the kernels are. With less noise the errors of splines and of the kernels themselves
would decide. What the mean of that process leaves unexplained along the paths is the
size of a white part, with which trajectories can be followed to rounding: the
covariance is $a^2 K + \tau^2 I$.

A grid of one width serves a hill that ends. One with a long tail acts wherever the
swimmer goes, and a grid that is fine enough for its flanks has thousands of kernels:
such a force gets layers of kernels, finer where it asks for them.

References:
    MacKay, Neural Computation 4, 415 (1992); Rasmussen and Williams, Gaussian
    Processes for Machine Learning (2006), chapter 5.
"""

from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from pinav.arguments import on_device
from pinav.fitting.environments.kernels import (
    MOST_WEIGHTS,
    OFTEN,
    KernelGrid,
    finest_kernels,
    num_weights,
)
from pinav.fitting.environments.rates import ForceSamples
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
    kernel_centers,
)
from pinav.forces.priors import Matrix

KernelKind = type[KernelPotential] | type[KernelForce]
"""Kernels of which forces along exact paths are made."""

NOISE = 1e-3
"""Of the forces, relative to their root mean square."""

WHITE = 3.0
"""Size of the white part, in units of the force that is left unexplained."""

LEAST_SINGULAR = 1e-6
"""Relative size of what the forces say of the weights that is worth keeping."""

AS_FINE_AS_FORCES = Refinement(max_weights=int(OFTEN * MOST_WEIGHTS), envelope=True)
"""Asks for finer kernels where length scale or envelope end at a width."""


class ForcePrior(eqx.Module):
    """The prior of an environment's weights by the forces at samples.

    Attributes:
        mean: of the weights, given the forces.
        missed: error of the mean at the samples, relative to the forces.
        white: standard deviation of each weight beside the smooth process.
    """

    environment: AbstractLearnedForce
    chosen: Hyperparameters
    mean: Float[np.ndarray, " weight"]
    missed: float
    white: float

    @classmethod
    def of(
        cls, environment: AbstractLearnedForce, samples: ForceSamples
    ) -> "ForcePrior":
        """Search for the prior of highest evidence."""
        columns = force_columns(environment, samples.positions)
        targets = samples.forces.reshape(-1)
        size = _root_mean_square(targets) or 1.0
        data, prior = _independent(columns, targets), environment.prior()
        chosen = best_hyperparameters(data, prior, prior.start, NOISE * size)
        mean = posterior_mean(Whitened.of(data, prior.covariance(chosen.shape)), chosen)
        missed = columns @ mean - targets
        white = white_part(columns, missed)
        return cls(environment, chosen, mean, _root_mean_square(missed) / size, white)

    @property
    def suits(self) -> bool:
        """Whether the kernels are fine enough, and explain the forces."""
        asks = AS_FINE_AS_FORCES.is_needed(self.environment, self.chosen.shape)
        return not asks and self.missed < NOISE

    @property
    def force(self) -> Any:
        """The environment whose weights are the mean."""
        return with_weights(self.environment, self.mean)

    def root(self) -> Matrix:
        r"""$C$ with $C C^\top = a^2 K + \tau^2 I$, its columns from large to small."""
        smooth = self.environment.prior().covariance(self.chosen.shape)
        values, vectors = np.linalg.eigh(self.chosen.amplitude**2 * smooth)
        # A white part leaves room for what the smooth prior misses.
        variances = np.maximum(values, 0.0) + self.white**2
        return (vectors * np.sqrt(variances))[:, ::-1]


def choose_kernels(kind: KernelKind, samples: ForceSamples) -> ForcePrior | None:
    """The coarsest kernels of one width that suit the forces; None if none do."""
    least = NOISE * _root_mean_square(samples.forces)
    for laid in kernel_ladder(kind, samples.places):
        # No prior makes it easier to explain forces that no weights do.
        if _root_mean_square(regress(laid, samples)[1]) <= least:
            prior = ForcePrior.of(laid, samples)
            if prior.suits:
                return prior
    return None


def white_part(
    columns: Float[np.ndarray, "row weight"], missed: Float[np.ndarray, " row"]
) -> float:
    """Standard deviation of weights which together make up for missed forces."""
    lengths = np.sqrt(np.mean(np.sum(columns**2, axis=1)))
    return WHITE * _root_mean_square(missed) / float(lengths)


def kernel_ladder(
    kind: KernelKind, places: Float[np.ndarray, "place dim"]
) -> Iterator[AbstractLearnedForce]:
    """Untrained kernels around places, from coarse to fine until they are too many."""
    rule, make = AS_FINE_AS_FORCES, kind.with_zero_weights
    laid: Any = finest_kernels(make, places, rule.max_weights, KernelGrid())
    while laid is not None:
        yield laid
        laid = rule.finer(laid, places)


ACROSS, WIDTH, MARGIN = 6, 1.5, 2.0
"""Intervals of the widest layer along the extent of the positions; width of a kernel
and reach of a layer beyond the positions that ask for it, in intervals of the layer."""

MOST_LAYERS = 7
"""Layers at most."""

EXPLAINED = 1e-6
"""Error of a force, relative to the largest one, that asks for no finer kernels."""

SHARE = 0.3
"""Forces whose error is above this share of the largest error ask for finer kernels.
Others may miss because these do."""

ROUNDS = 12
"""Iterations of the variances of layers."""


def lay_layers(samples: ForceSamples) -> LayeredPotential:
    """Layers of kernels, each half as wide as the one before.

    The widest layer surrounds all places; each further one the positions whose force
    the wider ones leave unexplained.
    """
    forces = samples.forces
    levels = np.zeros(len(forces), int)
    laid = _layers_around(samples, levels)
    largest = float(np.linalg.norm(forces, axis=1).max())
    while True:
        _, missed = regress(laid, samples)
        errors = np.linalg.norm(missed.reshape(forces.shape), axis=1)
        asking = errors > max(EXPLAINED * largest, SHARE * errors.max())
        levels = levels + asking
        if not asking.any() or levels.max() >= MOST_LAYERS:
            return laid
        finer = _layers_around(samples, levels)
        if num_weights(finer) > AS_FINE_AS_FORCES.max_weights:
            return laid
        laid = finer


def _layers_around(
    samples: ForceSamples, levels: Int[np.ndarray, " point"]
) -> LayeredPotential:
    """Kernels of every level around the positions of this level or of finer ones."""
    extent, layers = float(np.ptp(samples.places, axis=0).max()), []
    for level in range(levels.max() + 1):
        around = samples.positions[levels >= level] if level else samples.places
        spacing = extent / ACROSS / 2.0**level
        centers = kernel_centers(around, spacing=spacing, margin=MARGIN * spacing)
        layers.append(KernelPotential.with_zero_weights(centers, WIDTH * spacing))
    return LayeredPotential(tuple(layers))


def layers_root(environment: LayeredPotential, samples: ForceSamples) -> Matrix:
    r"""A root of the prior of layers: weights of one layer are alike in size.

    A layer is as fine as its kernels, so that its weights need no length scale. Their
    standard deviations $s_l$ follow from the evidence by
    $s_l^2 \leftarrow \lVert m_l \rVert^2 / \gamma_l$, with the mean m of the weights
    and the number $\gamma_l$ of those that the forces determine.

    References:
        MacKay, Neural Computation 4, 415 (1992), eq. (21).
    """
    columns = force_columns(environment, samples.positions)
    targets = samples.forces.reshape(-1)
    noise = NOISE * float(np.sqrt(np.mean(targets**2))) or 1.0
    rows = columns / noise
    normal, pull = rows.T @ rows, rows.T @ (targets / noise)
    counts = [num_weights(layer) for layer in environment.layers]
    layer = np.repeat(np.arange(len(counts)), counts)
    variances = np.full(len(layer), 1.0 / normal.diagonal().mean())
    mean = np.zeros_like(pull)
    for _ in range(ROUNDS):
        covariance = np.linalg.inv(normal + np.diag(1.0 / variances))
        mean = covariance @ pull
        determined = 1.0 - covariance.diagonal() / variances
        squares, known = (np.bincount(layer, w) for w in (mean**2, determined))
        # A layer that explains nothing keeps a variance next to none.
        variances = np.maximum(squares / known, 1e-20 * squares.sum())[layer]
    white = white_part(columns, columns @ mean - targets)
    return np.diag(np.sqrt(variances + white**2))


def force_columns(
    environment: AbstractLearnedForce, positions: Float[np.ndarray, "point dim"]
) -> Float[np.ndarray, "row weight"]:
    """Force of each weight at each position, component after component."""
    with jax.enable_x64(new_val=True):
        columns = np.asarray(_columns(environment, on_device(positions)))
    return columns.reshape(-1, columns.shape[-1])


def with_weights(
    environment: AbstractLearnedForce, weights: Float[np.ndarray, " weight"]
) -> Any:
    """An environment with other weights, one after the other."""
    _, unravel = ravel_pytree(environment.parameters)
    with jax.enable_x64(new_val=True):
        parameters = unravel(on_device(weights))
    return eqx.tree_at(lambda e: e.parameters, environment, parameters)


def _root_mean_square(values: Float[np.ndarray, "..."]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def regress(
    environment: AbstractLearnedForce, samples: ForceSamples
) -> tuple[Float[np.ndarray, " weight"], Float[np.ndarray, " row"]]:
    """Weights of least squares, as small as they can be, and what they miss."""
    columns = force_columns(environment, samples.positions)
    targets = samples.forces.reshape(-1)
    weights = np.linalg.lstsq(columns, targets)[0]
    return weights, columns @ weights - targets


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
