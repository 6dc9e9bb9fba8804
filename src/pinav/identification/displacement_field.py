"""Displacements along an observed path by a field of position, for each weight."""

from collections.abc import Callable, Collection
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.dynamics import OverdampedSwimmer
from pinav.fitting import ravel_model
from pinav.forces import (
    AbstractLearnedForce,
    RollingPropulsion,
    UniformFlow,
    ZeroFlow,
    ZeroForce,
    as_learned_force,
)
from pinav.identification.likelihood import Field, block_means
from pinav.identification.parameters import DRIFT, GAIN
from pinav.identification.tracks import Blocks, round_up_to


def determined_directions(covariance: np.ndarray, hessian: np.ndarray) -> np.ndarray:
    """Directions of unit prior variance of which the data tell anything.

    A smooth prior has hundreds of weights and some tens of such directions; only they
    pass through the filter at each step of the search for the noise.
    """
    # A smooth prior is singular to rounding, where a Cholesky factor fails.
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    signal, turned = np.linalg.eigh(root.T @ hessian @ root)
    kept = signal > LEAST_SIGNAL
    columns = root @ turned[:, kept]
    # Widths in round numbers: one compiled likelihood serves all rounds.
    return np.pad(
        columns, ((0, 0), (0, round_up_to(columns.shape[1], 16) - kept.sum()))
    )


LEAST_SIGNAL = 1e-3
"""Information of the data on a direction, in units of its prior, that counts."""


def with_environment(
    swimmer: Any, environment: AbstractLearnedForce | None
) -> OverdampedSwimmer:
    """The swimmer with an environment, and a uniform flow that may be learned."""
    if isinstance(swimmer.flow, ZeroFlow):
        swimmer = eqx.tree_at(lambda s: s.flow, swimmer, UniformFlow(jnp.zeros(2)))
    return swimmer if environment is None else swimmer.with_environment(environment)


def displacements_by(
    swimmer: OverdampedSwimmer,
    learned: Collection[str],
    blocks: Blocks,
    mobility: Float[Array, "2 2"],
) -> Field:
    """Displacements by the weights of the environment and by what is known.

    Args:
        swimmer: its environment has weights, or is none.
        learned: paths of the numbers that are open.
        blocks: the observed path.
        mobility: tensor through which a propulsion moves the swimmer.
    """
    nothing = Field.nothing(blocks)
    gain, drift = nothing.gain, nothing.drift
    propulsion, flow = swimmer.propulsion, swimmer.flow
    if isinstance(propulsion, RollingPropulsion) and GAIN not in learned:
        gain = mobility @ propulsion.matrix
    if isinstance(flow, UniformFlow):
        drift = drift if DRIFT in learned else flow.velocity
        flow = ZeroFlow()
    passive = eqx.tree_at(
        lambda s: (s.propulsion, s.environment, s.flow),
        swimmer,
        (ZeroForce(), ZeroForce(), flow),
    )
    columns = nothing.columns
    environment = as_learned_force(swimmer.environment)
    if environment is not None:
        free, start = ravel_model(environment, lambda e: e.parameters)
        columns = _weight_columns(free, jnp.zeros_like(start), swimmer, blocks)
    return Field(columns, path_displacement(passive, blocks), gain, drift)


@eqx.filter_jit
def _weight_columns(
    free: Any, theta: Array, swimmer: OverdampedSwimmer, blocks: Blocks
) -> Float[Array, "block 2 weight"]:
    """Mean displacement in each block for each weight."""

    def along(theta: Float[Array, " weight"]) -> Float[Array, "block 2"]:
        environment = free(theta)

        def velocity(t: Array, x: Array) -> Array:
            return swimmer.mobility(x, environment(t, x, jnp.zeros_like(x)))

        return path_displacement(velocity, blocks)

    # Exact at any point, as the force is linear in its weights.
    _, linear = jax.linearize(along, theta)
    # A few weights at a time: all of them at every sample would take gigabytes.
    columns = jax.lax.map(linear, jnp.eye(theta.shape[0]), batch_size=32)
    return jnp.moveaxis(columns, 0, -1)


def path_displacement(
    velocity: Callable[[Any, Any], Array], blocks: Blocks
) -> Float[Array, "block 2"]:
    """Block means of a velocity field integrated along the observed path."""
    rates = jax.vmap(velocity)(blocks.times, blocks.positions)
    middle = (rates[1:] + rates[:-1]) / 2
    # Leaps between segments add a constant, which the filter forgets at each begin.
    steps = middle * jnp.diff(blocks.times)[:, None]
    path = jnp.concatenate([jnp.zeros((1, 2)), jnp.cumsum(steps, axis=0)])
    return block_means(path, blocks)
