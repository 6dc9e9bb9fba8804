r"""A network taught by another force, by Gauss-Newton regression.

From random weights a network fits noisy trajectories badly: its steps creep. Taught the
force of a kernel fit first, it is a few steps from its own best fit.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.fitting.gauss_newton import chord, low_rank
from pinav.fitting.lifting import FreeModel, freed
from pinav.forces import AbstractForce
from pinav.trajectories import Trajectories

STEPS, RANK, CHORD_STEPS, NUM_DAMPINGS, NUM_POINTS = 12, 128, 5, 5, 1600
"""Gauss-Newton steps, and the size of each; points at most at which is taught."""


class Lesson(eqx.Module):
    """A force at several places and times.

    Attributes:
        times: of each [T].
        positions: of each [L].
        forces: there, on a swimmer at rest [L T⁻²].
    """

    times: Float[Array, " point"]
    positions: Float[Array, "point dim"]
    forces: Float[Array, "point dim"]


def lesson(
    teacher: AbstractForce,
    trajectories: Trajectories,
    states: Float[np.ndarray, "trajectory time state"],
    *,
    dim: int,
    margin: float,
) -> Lesson:
    """The force of `teacher` at the samples, and again at points around them.

    Args:
        teacher: the force.
        trajectories: when it was sampled.
        states: at those times, smoothed.
        dim: how many of the states are positions.
        margin: standard deviation of the distance around the samples [L].
    """
    real = np.arange(states.shape[1]) < trajectories.lengths[:, None]
    times, positions = trajectories.times[real], states[real][:, :dim]
    stride = -(-2 * len(times) // NUM_POINTS)
    times, positions = times[::stride], positions[::stride]
    noise = np.random.default_rng(0).normal(scale=margin, size=positions.shape)
    times = jnp.asarray(np.tile(times, 2))
    positions = jnp.asarray(np.concatenate([positions, positions + noise]))
    return Lesson(times, positions, _forces(teacher, times, positions))


def distilled(network: Any, taught: Lesson) -> Any:
    """The neural force after a regression on what it is taught."""
    free, theta = freed(network, lambda force: force.parameters)
    damping = jnp.asarray(1.0)
    for _ in range(STEPS):
        theta, damping = _step(free, theta, damping, taught)
    return free(theta)


@eqx.filter_jit
def _forces(force: Any, times, positions):
    return jax.vmap(lambda t, x: force(t, x, jnp.zeros_like(x)))(times, positions)


@eqx.filter_jit
def _step(free: FreeModel, theta, damping, taught: Lesson):
    """The best of several damped chord steps, and its damping."""
    size = jnp.sqrt(jnp.mean(taught.forces**2))
    size = jnp.where(size > 0, size, 1.0)

    def force(theta, t, x):
        return free(theta)(t, x, jnp.zeros_like(x)) / size

    def residuals(theta):
        axes = (None, 0, 0)
        found = jax.vmap(force, axes)(theta, taught.times, taught.positions)
        return (found - taught.forces / size).reshape(-1)

    jacobian = jax.vmap(jax.jacrev(force), (None, 0, 0))(
        theta, taught.times, taught.positions
    ).reshape(-1, theta.shape[0])
    left, scale, right = low_rank(jacobian, RANK)
    before = residuals(theta)
    dampings = damping * 10.0 ** (jnp.arange(float(NUM_DAMPINGS)) - (NUM_DAMPINGS - 2))

    def attempt(damping):
        return chord(
            lambda z: residuals(theta + right @ z),
            (before, left, scale),
            damping,
            CHORD_STEPS,
        )

    moves, costs = jax.vmap(attempt)(dampings)
    costs = jnp.where(jnp.isfinite(costs), costs, jnp.inf)
    best = jnp.argmin(costs)
    lower = costs[best] < before @ before
    moved = jnp.where(lower, theta + right @ moves[best], theta)
    return moved, jnp.where(lower, dampings[best], 100.0 * damping)
