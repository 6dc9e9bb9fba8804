r"""Distillation of a force into a network, by Gauss-Newton regression.

From random weights a network fits noisy trajectories badly: its steps converge slowly.
Distilled from the force of a kernel fit, it is a few steps from its own best fit. The
force of a structured fit is known far better than that of free kernels, and is worth
steps in all directions of the weights, on a finer grid.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector
from pinav.fitting.engine.constant_priors import ParametricModel, ravel_model
from pinav.fitting.matching.damped_steps import (
    NETWORK_DAMPING,
    damped_step,
    full_step,
    pointwise,
    row_space,
)
from pinav.forces import AbstractForce, kernel_centers
from pinav.trajectories import Trajectories

STEPS, RANK, CHORD_STEPS, NUM_DAMPINGS = 16, 256, 5, 5
"""Gauss-Newton steps, and the size of each."""

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


def distil(network: Any, targets: DistillationTargets, *, closely: bool = False) -> Any:
    """The neural force after a regression on targets.

    Args:
        network: untrained.
        targets: what it is to learn.
        closely: until it is close to them, or can come no closer. Where targets can be
            reached the other way leaves up to a hundred times as much.
    """
    free, theta = ravel_model(network, lambda force: force.parameters)
    damping, left = jnp.asarray(NETWORK_DAMPING), [np.inf]
    while len(left) <= (FULL_STEPS if closely else STEPS):
        theta, damping, off = _step(free, theta, damping, targets, closely=closely)
        left.append(float(off))
        is_slow = len(left) > PATIENCE and left[-1] > SLOW * left[-PATIENCE]
        if closely and (left[-1] <= CLOSE or is_slow):
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
    *,
    closely: bool,
) -> tuple[Float[Array, " parameter"], Float[Array, ""], Float[Array, ""]]:
    """The best of several damped steps, its damping, and what it leaves.

    What it leaves is a root mean square, relative to that of the forces.
    """

    def force(theta: Float[Array, " parameter"], t: Scalar, x: Vector) -> Vector:
        return free(theta)(t, x, jnp.zeros_like(x))

    residuals, jacobian = pointwise(
        force,
        theta,
        (targets.times, targets.positions),
        targets.forces,
        jnp.sqrt(jnp.mean(targets.forces**2)),
    )
    residual = residuals(theta)
    if not closely:
        step = damped_step(
            residuals,
            theta,
            (residual, jacobian),
            damping,
            rank=RANK,
            num_dampings=NUM_DAMPINGS,
            chord_steps=CHORD_STEPS,
        )
        after = step.theta
    else:
        slopes, along = jacobian, lambda z: z
        if len(theta) > FULL_RANK:
            basis = row_space(jacobian, FULL_RANK)
            slopes, along = jacobian @ basis, lambda z: basis @ z
        step = full_step(
            lambda z: residuals(theta + along(z)),
            jnp.zeros(slopes.shape[1]),
            (residual, slopes),
            damping,
            dampings=FULL_DAMPINGS,
            chord_steps=FULL_CHORD_STEPS,
        )
        after = theta + along(step.theta)
    off = jnp.sqrt(step.left * jnp.mean(residual**2))
    return after, step.damping, off
