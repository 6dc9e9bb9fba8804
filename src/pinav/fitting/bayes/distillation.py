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
from pinav.fitting.engine.local_model import ParametricModel, ravel_model
from pinav.fitting.matching.damped_steps import (
    NETWORK_DAMPING,
    LinearisedResiduals,
    damped_step,
    full_step,
    pointwise,
    row_space,
)
from pinav.forces import AbstractForce, kernel_centers
from pinav.trajectories import Trajectories


class Distillation(eqx.Module):
    """Settings of the distillation of a force into a network.

    Attributes:
        spacing: of places of targets beside the samples, in widths.
        num_points: places beside the samples, at most.
        margin: reach of these beyond the samples, in widths.
        num_samples: samples at most.
        closely: until the network is close to the targets, or can come no closer, with
            all directions of its weights; targets that can be reached the other way
            leaves up to a hundred times as far away.
        steps: Gauss-Newton steps at most.
        rank: directions of the weights of each step at most.
        chord_steps: iterations of a step with the Jacobian held.
        dampings: dampings that are tried, relative to the last one; of steps in few
            directions there are `num_dampings`, a factor of ten apart.
        close: root mean square of what a network is off, relative to that of the
            forces, that is close.
        slow: factor by which it must fall in `patience` steps for others to be worth
            their time.
    """

    spacing: float = 0.7
    num_points: int = 1200
    margin: float = 4.0
    num_samples: int = 400
    closely: bool = False
    steps: int = 16
    rank: int = 256
    chord_steps: int = 5
    num_dampings: int = 5
    dampings: tuple[float, ...] = (0.1, 1.0, 10.0)
    close: float = 2e-3
    slow: float = 0.85
    patience: int = 10


OF_KERNELS = Distillation()
"""As fine as free kernels vary."""

OF_STRUCTURE = Distillation(
    spacing=0.45, num_points=1500, closely=True, steps=100, rank=1536, chord_steps=4
)
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
    how: Distillation = OF_KERNELS,
) -> DistillationTargets:
    """Values of a force at the samples, and on a grid around them.

    Args:
        dim: how many of the states are positions.
        width: over which the force varies [L].
    """
    real = np.arange(states.shape[1]) < trajectories.lengths[:, None]
    times, samples = trajectories.times[real], states[real][:, :dim]
    spacing, margin = how.spacing * width, how.margin * width
    points = kernel_centers(samples, spacing=spacing, margin=margin)
    rng = np.random.default_rng(0)
    if len(points) > how.num_points:
        points = points[rng.choice(len(points), how.num_points, replace=False)]
    stride = -(-len(times) // how.num_samples)
    when = np.concatenate([times[::stride], rng.choice(times, len(points))])
    where = np.concatenate([samples[::stride], points])
    when, where = jnp.asarray(when), jnp.asarray(where)
    return DistillationTargets(when, where, forces(force, when, where))


def distil(
    network: Any, targets: DistillationTargets, how: Distillation = OF_KERNELS
) -> Any:
    """The neural force after a regression on targets, from untrained weights."""
    free, theta = ravel_model(network, lambda force: force.parameters)
    damping, left = jnp.asarray(NETWORK_DAMPING), [np.inf]
    while len(left) <= how.steps:
        theta, damping, off = _step(free, theta, damping, targets, how)
        left.append(float(off))
        is_slow = len(left) > how.patience and left[-1] > how.slow * left[-how.patience]
        if how.closely and (left[-1] <= how.close or is_slow):
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
    how: Distillation,
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
    problem = LinearisedResiduals(residuals, theta, residuals(theta), jacobian, damping)
    if how.closely:
        large = len(theta) > how.rank
        step = full_step(
            problem,
            directions=row_space(jacobian, how.rank) if large else None,
            dampings=how.dampings,
            chord_steps=how.chord_steps,
        )
    else:
        step = damped_step(
            problem,
            rank=how.rank,
            num_dampings=how.num_dampings,
            chord_steps=how.chord_steps,
        )
    off = jnp.sqrt(step.left * jnp.mean(problem.residual**2))
    return step.theta, step.damping, off
