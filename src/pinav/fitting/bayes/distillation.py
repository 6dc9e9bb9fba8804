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
from pinav.fitting.matching.gauss_newton import chord, row_space
from pinav.forces import AbstractForce, kernel_centers
from pinav.trajectories import Trajectories

STEPS, CHORD_STEPS, DAMPINGS = 100, 4, (0.1, 1.0, 10.0)
"""Damped steps at most, iterations of each with the Jacobian held, and the dampings
that are tried, relative to the last one."""

RANK = 1536
"""Directions of the weights at most, of a network that has more of them. A tenth of
those of the default network left up to a hundred times the error."""

DAMPING = 1e3
"""Of the first step: with less, a third of the networks saturate and learn no more."""

SLOW, PATIENCE = 0.85, 10
"""By how much what a network is off must fall, in how many steps, for others to be
worth their time."""

MARGIN, NUM_SAMPLES = 4.0, 400
"""Reach of the grid of targets beyond the samples, in widths; samples at most."""


class Care(eqx.Module):
    """The accuracy of a distillation.

    Attributes:
        close: root mean square of what the network is off, relative to that of the
            forces, that is enough.
        spacing: of the grid of targets, in widths.
        num_points: of that grid, at most.
    """

    close: float
    spacing: float
    num_points: int


OF_KERNELS = Care(close=1e-2, spacing=0.7, num_points=1200)
"""Free kernels are off by one percent or more themselves."""

OF_STRUCTURE = Care(close=2e-3, spacing=0.45, num_points=1500)
"""A structured force is off by some tenths of a percent. On a coarser grid a network
that may turn misses ten times as much between the places."""


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
    care: Care = OF_KERNELS,
) -> DistillationTargets:
    """Values of a force at the samples, and on a grid around them.

    Args:
        force: the force.
        trajectories: when it was sampled.
        states: at those times, smoothed.
        dim: how many of the states are positions.
        width: over which the force varies [L]; the grid is finer, and reaches
            `MARGIN` of them beyond the samples.
        care: how fine the grid is.
    """
    real = np.arange(states.shape[1]) < trajectories.lengths[:, None]
    times, samples = trajectories.times[real], states[real][:, :dim]
    grid = kernel_centers(samples, spacing=care.spacing * width, margin=MARGIN * width)
    rng = np.random.default_rng(0)
    if len(grid) > care.num_points:
        grid = grid[rng.choice(len(grid), care.num_points, replace=False)]
    stride = -(-len(times) // NUM_SAMPLES)
    when = np.concatenate([times[::stride], rng.choice(times, len(grid))])
    where = np.concatenate([samples[::stride], grid])
    when, where = jnp.asarray(when), jnp.asarray(where)
    return DistillationTargets(when, where, forces(force, when, where))


def distil(network: Any, targets: DistillationTargets, care: Care = OF_KERNELS) -> Any:
    """The neural force after a regression on targets."""
    free, theta = ravel_model(network, lambda force: force.parameters)
    damping, left = jnp.asarray(DAMPING), [np.inf]
    while len(left) <= STEPS and left[-1] > care.close:
        theta, damping, off = _step(free, theta, damping, targets)
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
) -> tuple[Float[Array, " parameter"], Float[Array, ""], Float[Array, ""]]:
    """The best of several damped steps, its damping, and what it leaves.

    What it leaves is a root mean square, relative to that of the forces.
    """
    size = jnp.sqrt(jnp.mean(targets.forces**2))
    size = jnp.where(size > 0, size, 1.0)

    def force(theta: Float[Array, " parameter"], t: Scalar, x: Vector) -> Vector:
        return free(theta)(t, x, jnp.zeros_like(x)) / size

    def residuals(theta: Float[Array, " parameter"]) -> Float[Array, " residual"]:
        axes = (None, 0, 0)
        computed = jax.vmap(force, axes)(theta, targets.times, targets.positions)
        return (computed - targets.forces / size).reshape(-1)

    residual = residuals(theta)
    jacobian = jax.vmap(jax.jacrev(force), (None, 0, 0))(
        theta, targets.times, targets.positions
    ).reshape(-1, theta.shape[0])
    slopes, along = jacobian, lambda z: z
    if len(theta) > RANK:
        basis = row_space(jacobian, RANK)
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
            CHORD_STEPS,
        )

    # one after the other: side by side they would need several such factors at once
    dampings = damping * jnp.asarray(DAMPINGS)
    moves, costs = jax.lax.map(attempt, dampings)
    best, cost = jnp.nanargmin(costs), residual @ residual
    is_lower = costs[best] < cost
    return (
        jnp.where(is_lower, theta + along(moves[best]), theta),
        jnp.where(is_lower, dampings[best], 100.0 * damping),
        jnp.sqrt(jnp.where(is_lower, costs[best], cost) / len(residual)),
    )
