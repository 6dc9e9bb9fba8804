r"""Variance of rollouts that the wandering velocity of a swimmer causes.

A rollout follows the mean path. Its error obeys to first order, with the quick and the
slow velocity w and u of `WanderingVelocity`,

$$\dot{\delta y} = A(t)\,\delta y + w + u, \qquad A = \partial f / \partial y .$$

A start that is fitted to the first K samples takes a part of what wandered there for
an offset: $\delta s = L\,\delta y_{1 \dots K}$ with L the pseudo-inverse of the
sensitivities $\Phi$ of the observed samples, so that the error of a prediction is
$\delta y - \Phi\,\delta s$. The covariance of $(\delta y, w, u, \delta s)$ is
propagated from sample to sample with A held in between.

References:
    Van Loan, IEEE Trans. Autom. Control 23, 395 (1978), the integral of the noise.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.linalg import expm

from pinav.dynamics import AbstractDynamics
from pinav.systems import WanderingVelocity
from pinav.trajectories import Trajectory

SHORT = 0.25
"""Largest change of any component in a step whose noise is integrated directly."""


def wandering_variance(
    dynamics: AbstractDynamics,
    wandering: WanderingVelocity,
    piece: Trajectory,
    path: Float[np.ndarray, "time state"],
    count: int,
) -> Float[np.ndarray, "time state"]:
    """Variance of the error of a rollout by the wandering velocity [L²].

    Args:
        dynamics: the first-order model that was rolled out, under the commands.
        wandering: the velocity that the model leaves out.
        piece: what was observed, from the start on.
        path: the rollout at the times of the piece; not finite once diverged.
        count: number of first samples from which the start was estimated.

    Returns:
        The variance at each time after the first samples (at those, of what wandered
        up to them alone); NaN where the path is not finite.
    """
    finite = np.all(np.isfinite(path), axis=1)
    held = jnp.asarray(np.where(finite.reshape(-1, 1), path, path[0]))
    jacobians = np.asarray(_jacobians(dynamics, jnp.asarray(piece.times), held))
    frequency = piece.commands.get("frequency", np.zeros(len(piece.times)))
    strength = np.asarray(wandering.strength(jnp.asarray(frequency)))[:-1]
    intervals = np.diff(piece.times)
    mean = 0.5 * (jacobians[1:] + jacobians[:-1])
    matrices, noises = _transitions(mean, strength, intervals, wandering)
    variance = _propagate(matrices, noises, _start_weights(matrices, piece, count))
    variance[~finite] = np.nan
    return variance


@eqx.filter_jit
def _jacobians(
    dynamics: AbstractDynamics,
    times: Float[Array, " time"],
    path: Float[Array, "time state"],
) -> Float[Array, "time state state"]:
    """Of the vector field by the state, along a path."""
    slopes = jax.jacfwd(lambda y, t: dynamics(t, y))
    return jax.vmap(slopes)(path, times)


def _transitions(
    jacobians: Float[np.ndarray, "step state state"],
    strength: Float[np.ndarray, " step"],
    intervals: Float[np.ndarray, " step"],
    wandering: WanderingVelocity,
) -> tuple[np.ndarray, np.ndarray]:
    """Of error and both velocities, in units of their strengths, over each interval."""
    steps, dim, _ = jacobians.shape
    unit = np.eye(dim)
    rates = np.zeros((steps, 3 * dim, 3 * dim))
    rates[:, :dim, :dim] = jacobians
    rates[:, :dim, dim : 2 * dim] = strength[:, None, None] * unit
    rates[:, :dim, 2 * dim :] = wandering.slow * unit
    decays = np.repeat([1 / wandering.memory, 1 / wandering.slow_memory], dim)
    rates[:, dim:, dim:] = -np.diag(decays)
    source = np.diag(np.concatenate([np.zeros(dim), 2 * decays]))
    scale = np.abs(rates * intervals[:, None, None]).sum(axis=2).max(initial=SHORT)
    # The exponential of a long interval overflows; that of a short one is doubled.
    doublings = int(np.ceil(np.log2(scale / SHORT)))
    short = intervals[:, None, None] / 2**doublings
    zero = np.zeros_like(rates)
    both = np.block([[-rates, source + zero], [zero, np.swapaxes(rates, 1, 2)]])
    powers = expm(both * short)
    matrices = np.swapaxes(powers[:, 3 * dim :, 3 * dim :], 1, 2)
    noises = matrices @ powers[:, : 3 * dim, 3 * dim :]
    for _ in range(doublings):
        noises = noises + matrices @ noises @ np.swapaxes(matrices, 1, 2)
        matrices = matrices @ matrices
    return matrices, noises


def _start_weights(
    matrices: Float[np.ndarray, "step joint joint"], piece: Trajectory, count: int
) -> Float[np.ndarray, "sample state state"]:
    """L: what the error of each of the first samples adds to the estimated start."""
    dim = piece.states.shape[1]
    to_start = [np.eye(dim)]
    for matrix in matrices[: count - 1]:
        to_start.append(matrix[:dim, :dim] @ to_start[-1])
    rows = np.stack(to_start) * piece.observed[:count, :, None]
    inverse = np.linalg.pinv(rows.reshape(-1, dim))
    return np.swapaxes(inverse.reshape(dim, -1, dim), 0, 1)


def _propagate(
    matrices: Float[np.ndarray, "step joint joint"],
    noises: Float[np.ndarray, "step joint joint"],
    weights: Float[np.ndarray, "sample state state"],
) -> Float[np.ndarray, "time state"]:
    """Variance of the prediction at each sample."""
    dim = weights.shape[1]
    size = 3 * dim
    joint = np.diag(np.repeat([0.0, 1.0, 1.0, 0.0], dim))
    step, to_start = np.eye(4 * dim), np.eye(dim)
    variances = [np.zeros(dim)]
    for index, (matrix, noise) in enumerate(zip(matrices, noises, strict=True)):
        step[:size, :size] = matrix
        joint = step @ joint @ step.T
        joint[:size, :size] += noise
        if index + 1 < len(weights):
            added = np.eye(4 * dim)
            added[size:, :dim] = weights[index + 1]
            joint = added @ joint @ added.T
        to_start = matrix[:dim, :dim] @ to_start
        error = np.concatenate([np.eye(dim), np.zeros((dim, 2 * dim)), -to_start], 1)
        variances.append(np.einsum("ij,jk,ik->i", error, joint, error))
    return np.stack(variances)
