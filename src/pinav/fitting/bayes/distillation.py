r"""Distillation of a force into a network, by Gauss-Newton regression.

From random weights a network fits noisy trajectories badly: its steps converge slowly.
Distilled from the force of a kernel fit, it is a few steps from its own best fit. The
force of a structured fit is known far better than that of free kernels, and is worth
steps in all directions of the weights, on a finer grid.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector
from pinav.fitting.engine.constant_priors import ParametricModel, ravel_model
from pinav.fitting.matching.gauss_newton import chord, damped_step, row_space
from pinav.forces import AbstractForce, kernel_centers
from pinav.trajectories import Trajectories

STEPS, RANK, CHORD_STEPS, NUM_DAMPINGS = 16, 256, 5, 5
"""Gauss-Newton steps, and the size of each."""

DAMPING = 1e3
"""Of the first step: with less, a third of the networks saturate and learn no more."""

FULL_RANK, FULL_STEPS, FULL_CHORD_STEPS, FULL_DAMPINGS = 1536, 100, 4, (0.1, 1.0, 10.0)
"""The same of a close distillation, which takes all directions of a network that has no
more of them; the dampings are relative to the last one."""

CLOSE, SLOW, PATIENCE = 2e-3, 0.85, 10
"""Root mean square of what a network is off, relative to that of the forces, that is
close; and by how much it must fall, in how many steps, for others to be worth them."""

MARGIN, NUM_SAMPLES = 4.0, 400
"""Reach of the grid of targets beyond the samples, in widths; samples at most."""


class DistillationGrid(eqx.Module):
    """Places of targets beside the samples.

    Attributes:
        spacing: in widths.
        num_points: at most.
    """

    spacing: float
    num_points: int


OF_KERNELS = DistillationGrid(spacing=0.7, num_points=1200)
"""As fine as free kernels vary."""

OF_STRUCTURE = DistillationGrid(spacing=0.45, num_points=1500)
"""As fine as a network that may turn asks for: on the coarser grid it misses a ring ten
times as much between the places as at them."""


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
    grid: DistillationGrid = OF_KERNELS,
) -> DistillationTargets:
    """Values of a force at the samples, and on a grid around them.

    Args:
        dim: how many of the states are positions.
        width: over which the force varies [L]; the grid is finer, and reaches
            `MARGIN` of them beyond the samples.
    """
    real = np.arange(states.shape[1]) < trajectories.lengths[:, None]
    times, samples = trajectories.times[real], states[real][:, :dim]
    spacing, margin = grid.spacing * width, MARGIN * width
    points = kernel_centers(samples, spacing=spacing, margin=margin)
    rng = np.random.default_rng(0)
    if len(points) > grid.num_points:
        points = points[rng.choice(len(points), grid.num_points, replace=False)]
    stride = -(-len(times) // NUM_SAMPLES)
    when = np.concatenate([times[::stride], rng.choice(times, len(points))])
    where = np.concatenate([samples[::stride], points])
    when, where = jnp.asarray(when), jnp.asarray(where)
    return DistillationTargets(when, where, forces(force, when, where))


def distil(network: Any, targets: DistillationTargets) -> Any:
    """The neural force after a regression on targets."""
    free, theta = ravel_model(network, lambda force: force.parameters)
    damping = jnp.asarray(DAMPING)
    for _ in range(STEPS):
        theta, damping = _step(free, theta, damping, targets)
    return free(theta)


def distil_closely(network: Any, targets: DistillationTargets) -> Any:
    """The same until the network is close to the targets, or can come no closer.

    Where they can be reached `distil` leaves up to a hundred times as much.
    """
    free, theta = ravel_model(network, lambda force: force.parameters)
    damping, left = jnp.asarray(DAMPING), [np.inf]
    while len(left) <= FULL_STEPS and left[-1] > CLOSE:
        theta, damping, off = _full_step(free, theta, damping, targets)
        left.append(float(off))
        if len(left) > PATIENCE and left[-1] > SLOW * left[-PATIENCE]:
            break
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
    residuals, jacobian = _linearise(free, theta, targets)
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


def _linearise(
    free: ParametricModel,
    theta: Float[Array, " parameter"],
    targets: DistillationTargets,
) -> tuple[
    Callable[[Float[Array, " parameter"]], Float[Array, " residual"]],
    Float[Array, "residual parameter"],
]:
    """What a network is off, relative to the forces, and its slopes at a point."""
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
    return residuals, jacobian


@eqx.filter_jit
def _full_step(
    free: ParametricModel,
    theta: Float[Array, " parameter"],
    damping: Float[Array, ""],
    targets: DistillationTargets,
) -> tuple[Float[Array, " parameter"], Float[Array, ""], Float[Array, ""]]:
    """The best of several damped steps, its damping, and what it leaves.

    What it leaves is a root mean square, relative to that of the forces.
    """
    residuals, jacobian = _linearise(free, theta, targets)
    residual = residuals(theta)
    slopes, along = jacobian, lambda z: z
    if len(theta) > FULL_RANK:
        basis = row_space(jacobian, FULL_RANK)
        slopes, along = jacobian @ basis, lambda z: basis @ z
    normal = slopes.T @ slopes

    def attempt(
        damping: Float[Array, ""],
    ) -> tuple[Float[Array, " direction"], Float[Array, ""]]:
        factor = jax.scipy.linalg.cho_factor(normal + damping * jnp.eye(len(normal)))

        def newton(
            current: Float[Array, " residual"], z: Float[Array, " direction"]
        ) -> Float[Array, " direction"]:
            gradient = slopes.T @ current + damping * z
            return z - jax.scipy.linalg.cho_solve(factor, gradient)

        return chord(
            lambda z: residuals(theta + along(z)),
            residual,
            jnp.zeros(len(normal)),
            newton,
            FULL_CHORD_STEPS,
        )

    # one after the other: side by side they would need several such factors at once
    dampings = damping * jnp.asarray(FULL_DAMPINGS)
    moves, costs = jax.lax.map(attempt, dampings)
    best, cost = jnp.nanargmin(costs), residual @ residual
    is_lower = costs[best] < cost
    return (
        jnp.where(is_lower, theta + along(moves[best]), theta),
        jnp.where(is_lower, dampings[best], 100.0 * damping),
        jnp.sqrt(jnp.where(is_lower, costs[best], cost) / len(residual)),
    )
