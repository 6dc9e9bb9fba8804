r"""Distillation of a force into a network, by Gauss-Newton regression.

From random weights a network fits noisy trajectories badly: its steps converge slowly.
Distilled from the force of a kernel fit, it is a few steps from its own best fit.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector
from pinav.fitting.engine.parametric_model import ParametricModel, ravel_model
from pinav.fitting.matching.gauss_newton import damped_step
from pinav.forces import AbstractForce, kernel_centers
from pinav.trajectories import Trajectories

STEPS, RANK, CHORD_STEPS, NUM_DAMPINGS = 16, 256, 5, 5
"""Gauss-Newton steps, and the size of each."""

DAMPING = 1e3
"""Of the first step: with less, a third of the networks saturate and learn no more."""

SPACING, MARGIN = 0.7, 4.0
"""Of the grid of targets, in widths."""

NUM_SAMPLES, NUM_POINTS = 400, 1200
"""Samples, and points of the grid, at most."""


class DistillationTargets(eqx.Module):
    """A force at several places and times.

    Attributes:
        times: of each [T].
        positions: of each [L].
        forces: there, on a swimmer at rest [L T⁻²].
    """

    times: Float[Array, " point"]
    positions: Float[Array, "point dim"]
    forces: Float[Array, "point dim"]


def distillation_targets(
    force: AbstractForce,
    trajectories: Trajectories,
    states: Float[np.ndarray, "trajectory time state"],
    *,
    dim: int,
    width: float,
) -> DistillationTargets:
    """Values of a force at the samples, and on a grid around them.

    Args:
        force: the force.
        trajectories: when it was sampled.
        states: at those times, smoothed.
        dim: how many of the states are positions.
        width: over which the force varies [L]; the grid is finer, and reaches
            `MARGIN` of them beyond the samples.
    """
    real = np.arange(states.shape[1]) < trajectories.lengths[:, None]
    times, samples = trajectories.times[real], states[real][:, :dim]
    grid = kernel_centers(samples, spacing=SPACING * width, margin=MARGIN * width)
    rng = np.random.default_rng(0)
    if len(grid) > NUM_POINTS:
        grid = grid[rng.choice(len(grid), NUM_POINTS, replace=False)]
    stride = -(-len(times) // NUM_SAMPLES)
    when = np.concatenate([times[::stride], rng.choice(times, len(grid))])
    where = np.concatenate([samples[::stride], grid])
    when, where = jnp.asarray(when), jnp.asarray(where)
    return DistillationTargets(when, where, forces(force, when, where))


def distil(network: Any, targets: DistillationTargets) -> Any:
    """The neural force after a regression on targets."""
    free, theta = ravel_model(network, lambda force: force.parameters)
    damping = jnp.asarray(DAMPING)
    for _ in range(STEPS):
        theta, damping = _step(free, theta, damping, targets)
    return free(theta)


@eqx.filter_jit
def forces(
    force: Any, times: Float[Array, " point"], positions: Float[Array, "point dim"]
) -> Float[Array, "point dim"]:
    """Force on a swimmer at rest, at several places and times [L T⁻²]."""
    return jax.vmap(lambda t, x: force(t, x, jnp.zeros_like(x)))(times, positions)


@eqx.filter_jit
def _step(
    free: ParametricModel,
    theta: Float[Array, " parameter"],
    damping: Float[Array, ""],
    targets: DistillationTargets,
) -> tuple[Float[Array, " parameter"], Float[Array, ""]]:
    """The best of several damped chord steps, and its damping."""
    size = jnp.sqrt(jnp.mean(targets.forces**2))
    size = jnp.where(size > 0, size, 1.0)

    def force(theta: Float[Array, " parameter"], t: Scalar, x: Vector) -> Vector:
        return free(theta)(t, x, jnp.zeros_like(x)) / size

    def residuals(theta: Float[Array, " parameter"]) -> Float[Array, " residual"]:
        axes = (None, 0, 0)
        computed = jax.vmap(force, axes)(theta, targets.times, targets.positions)
        return (computed - targets.forces / size).reshape(-1)

    jacobian = jax.vmap(jax.jacrev(force), (None, 0, 0))(
        theta, targets.times, targets.positions
    ).reshape(-1, theta.shape[0])
    step = damped_step(
        residuals,
        theta,
        (residuals(theta), jacobian),
        damping,
        rank=RANK,
        num_dampings=NUM_DAMPINGS,
        chord_steps=CHORD_STEPS,
    )
    return step.theta, step.damping
