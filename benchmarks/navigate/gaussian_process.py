r"""The published baseline: a Gaussian process of what physics does not explain.

Velocities, or accelerations where there is inertia, are differences of what was
observed, less what is known: $D(x)$ in $\dot x = a_0 f n(\theta) + D(x)$. The process
sees neither the dynamics between samples nor the errors of positions.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import minimize
from scipy.signal import savgol_filter

from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.forces import KernelForce
from pinav.trajectories import Trajectories, Trajectory

WINDOW, ORDER = 7, 2
"""Samples and order of the polynomials whose slopes are the rates."""

POINTS = 300
"""Samples that the process sees, evenly chosen from all."""


def gaussian_process(
    known: Swimmer | OverdampedSwimmer, trajectories: Trajectories
) -> Swimmer | OverdampedSwimmer:
    """The swimmer with the mean of the process as its environment.

    Length scale, amplitude and noise, common to both components, maximise the marginal
    likelihood.

    Args:
        known: its environment is not used.
        trajectories: complete, in equal time steps, of nine samples or more.

    Raises:
        InputError: the trajectories are not of that kind.

    References:
        Rasmussen and Williams, Gaussian Processes for Machine Learning, eq. (2.30);
        arXiv:2212.00188 for mismatch models of magnetic microrobots.
    """
    xs, residuals = _residuals(known, trajectories)
    chosen = np.unique(np.linspace(0, len(xs) - 1, POINTS).round().astype(int))
    xs, residuals = xs[chosen], residuals[chosen]
    scale = float(np.mean(np.std(xs, axis=0)))
    size = float(np.std(residuals)) or 1.0
    first = np.log([scale / 2, size, size / 4])
    squares = np.sum((xs[:, None] - xs[None]) ** 2, axis=-1)
    slope = jax.jit(jax.value_and_grad(_negative_log_likelihood))
    given = jnp.asarray(squares), jnp.asarray(residuals)

    def objective(logs: Float[np.ndarray, "3"]) -> tuple[float, Float[np.ndarray, "3"]]:
        value, gradient = slope(jnp.asarray(logs), *given)
        return float(value), np.asarray(gradient)

    bounds = [(v - 3.0, v + 3.0) for v in first]
    optimum = minimize(objective, first, jac=True, bounds=bounds, method="L-BFGS-B")
    logs = jnp.asarray(optimum.x)
    explained = jnp.linalg.solve(_covariance(logs, given[0]), given[1])
    weights = jnp.exp(2 * logs[1]) * explained
    width = float(np.exp(optimum.x[0]))
    return known.with_environment(KernelForce(weights, jnp.asarray(xs), width))


def _residuals(
    known: Swimmer | OverdampedSwimmer, trajectories: Trajectories
) -> tuple[Float[np.ndarray, "sample 2"], Float[np.ndarray, "sample 2"]]:
    """Positions, and the observed rate less that of known physics."""
    rate = eqx.filter_jit(eqx.filter_vmap(known.without_environment()))
    xs, residuals = [], []
    for index in range(len(trajectories.lengths)):
        each = trajectories.trajectory(index)
        step = _uniform_step(index, each)
        slopes = savgol_filter(each.states, WINDOW, ORDER, deriv=1, delta=step, axis=0)
        modelled = rate(jnp.asarray(each.times), jnp.asarray(each.states))
        inner = slice(WINDOW // 2, -(WINDOW // 2))
        residuals.append((slopes - np.asarray(modelled))[inner, -2:])
        xs.append(each.states[inner, :2])
    return np.concatenate(xs), np.concatenate(residuals)


def _uniform_step(index: int, trajectory: Trajectory) -> float:
    steps = np.diff(trajectory.times)
    even = len(steps) >= WINDOW + 1 and np.allclose(steps, steps[0], rtol=1e-6)
    if not even or not np.all(trajectory.observed):
        raise InputError(
            f"gaussian_process: trajectory {index} is not complete, in equal time "
            f"steps and {WINDOW + 2} samples long; choose another one"
        )
    return float(steps[0])


def _covariance(
    logs: Float[Array, "3"], squares: Float[Array, "point point"]
) -> Float[Array, "point point"]:
    """Of the residuals, by log length scale, log amplitude and log noise."""
    kernel = jnp.exp(2 * logs[1] - squares / (2 * jnp.exp(2 * logs[0])))
    return kernel + jnp.exp(2 * logs[2]) * jnp.eye(len(squares))


def _negative_log_likelihood(
    logs: Float[Array, "3"],
    squares: Float[Array, "point point"],
    residuals: Float[Array, "point 2"],
) -> Float[Array, ""]:
    factor = jnp.linalg.cholesky(_covariance(logs, squares))
    white = jax.scipy.linalg.solve_triangular(factor, residuals, lower=True)
    log_det = jnp.sum(jnp.log(jnp.diagonal(factor)))
    return jnp.sum(white**2) / 2 + residuals.shape[1] * log_det
