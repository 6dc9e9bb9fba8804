r"""Coverage: the fraction of errors that lie inside the bands of a fit.

To first order a predicted state depends on the parameters $\theta$ and the start s as
$\delta y = J\,\delta\theta + \Phi\,\delta s$. A start estimated from the first samples
depends on the parameters too, $\delta s = S\,\delta\theta + \epsilon$ with $\epsilon$
the noise of those samples, so that

$$\mathrm{Cov}\,y = (J + \Phi S)\,C\,(J + \Phi S)^\top + \Phi\,\Sigma_s\,\Phi^\top,$$

$\Sigma_s = \sigma^2 (\Phi^\top\Phi)^{-1}$ over those samples. What is observed has the
noise $\sigma$ on top.

A rollout follows the mean path. What a wandering velocity adds to its error obeys to
first order, with the quick and the slow velocity w and u of `WanderingVelocity`,

$$\dot{\delta y} = A(t)\,\delta y + w + u, \qquad A = \partial f / \partial y .$$

A start that is fitted to the first K samples takes a part of what wandered there for
an offset: $\delta s = L\,\delta y_{1 \dots K}$ with L the pseudo-inverse of the
sensitivities $\Phi$ of the observed samples, so that the error of a prediction is
$\delta y - \Phi\,\delta s$. The covariance of $(\delta y, w, u, \delta s)$ is
propagated from sample to sample with A held in between.

References:
    Van Loan, IEEE Trans. Autom. Control 23, 395 (1978), the integral of the noise.
"""

import itertools
from statistics import NormalDist

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.linalg import expm

from pinav.arguments import on_device
from pinav.dynamics import AbstractDynamics, FixedStep
from pinav.evaluation.force_fields import FieldMap
from pinav.evaluation.starts import (
    Starts,
    driven_models,
    first_samples,
    linearise_driven,
)
from pinav.fitting import Posterior
from pinav.fitting.engine.posterior import linear_rollout
from pinav.systems import WanderingVelocity
from pinav.trajectories import Trajectories, Trajectory

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
    dim = path.shape[1]
    steps = itertools.accumulate(
        matrices[:, :dim, :dim], lambda done, step: step @ done, initial=np.eye(dim)
    )
    to_start = np.stack(list(steps))
    rows = to_start[:count] * piece.observed[:count, :, None]
    # Matrices L by which errors of the first samples add to the estimated start.
    weights = np.linalg.pinv(rows.reshape(-1, dim)).reshape(dim, -1, dim)
    variance = _propagate(matrices, noises, to_start, np.swapaxes(weights, 0, 1))
    variance[~finite] = np.nan
    return variance


@eqx.filter_jit
def _jacobians(
    dynamics: AbstractDynamics,
    times: Float[Array, " time"],
    path: Float[Array, "time state"],
) -> Float[Array, "time state state"]:
    """Jacobians of the vector field by the state, along a path."""
    slopes = jax.jacfwd(lambda y, t: dynamics(t, y))
    return jax.vmap(slopes)(path, times)


def _transitions(
    jacobians: Float[np.ndarray, "step state state"],
    strength: Float[np.ndarray, " step"],
    intervals: Float[np.ndarray, " step"],
    wandering: WanderingVelocity,
) -> tuple[np.ndarray, np.ndarray]:
    """Transition of error and both velocities, in their strengths, by interval."""
    steps, dim, _ = jacobians.shape
    unit = np.eye(dim)
    rates = np.zeros((steps, 3 * dim, 3 * dim))
    rates[:, :dim, :dim] = jacobians
    rates[:, :dim, dim : 2 * dim] = strength[:, None, None] * unit
    rates[:, :dim, 2 * dim :] = wandering.slow * unit
    memories = np.asarray([wandering.memory, wandering.slow_memory])
    decays = np.repeat(1 / memories, dim)
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


def _propagate(
    matrices: Float[np.ndarray, "step joint joint"],
    noises: Float[np.ndarray, "step joint joint"],
    to_start: Float[np.ndarray, "time state state"],
    weights: Float[np.ndarray, "sample state state"],
) -> Float[np.ndarray, "time state"]:
    dim = weights.shape[1]
    size = 3 * dim
    joint = np.diag(np.repeat([0.0, 1.0, 1.0, 0.0], dim))
    step = np.eye(4 * dim)
    variances = [np.zeros(dim)]
    for index, (matrix, noise) in enumerate(zip(matrices, noises, strict=True)):
        step[:size, :size] = matrix
        joint = step @ joint @ step.T
        joint[:size, :size] += noise
        if index + 1 < len(weights):
            added = np.eye(4 * dim)
            added[size:, :dim] = weights[index + 1]
            joint = added @ joint @ added.T
        blank, moved = np.zeros((dim, 2 * dim)), to_start[index + 1]
        error = np.concatenate([np.eye(dim), blank, -moved], axis=1)
        variances.append(np.einsum("ij,jk,ik->i", error, joint, error))
    return np.stack(variances)


NOMINAL = 0.95
"""Nominal coverage of bands."""


def normal_quantile(coverage: float = NOMINAL) -> float:
    """Standard deviations on either side that hold this part of a normal variable."""
    return NormalDist().inv_cdf((1.0 + coverage) / 2.0)


def normal_interval(
    mean: Float[np.ndarray, "*shape"],
    sd: Float[np.ndarray, "*shape"],
    coverage: float = NOMINAL,
) -> tuple[Float[np.ndarray, "*shape"], Float[np.ndarray, "*shape"]]:
    """Lower and upper end of the interval that holds this part of a normal variable."""
    half = normal_quantile(coverage) * sd
    return mean - half, mean + half


class Bands(eqx.Module):
    """Predicted states, not finite once diverged, and their deviations."""

    ys: Float[np.ndarray, "trajectory time state"]
    sd: Float[np.ndarray, "trajectory time state"]

    def observable_sd(self, noise: float) -> Float[np.ndarray, "trajectory time state"]:
        """Standard deviation of what is observed with this noise."""
        return np.sqrt(self.sd**2 + noise**2)


def rollout_bands(
    posterior: Posterior,
    trajectories: Trajectories,
    starts: Starts | None = None,
    *,
    noise: float = 0.0,
    wandering: WanderingVelocity | None = None,
) -> Bands:
    """Bands of rollouts, from the first samples or from estimated starts.

    Args:
        noise: standard deviation of the samples by which rollouts start.
    """
    theta, known = jnp.asarray(posterior.mean), len(posterior.mean)
    count, size = len(trajectories), trajectories.states.shape[2]
    first, samples = trajectories.states[:, 0], 1
    by_parameter = np.zeros((count, size, known))
    spread = np.tile(noise**2 * np.eye(size), (count, 1, 1))
    if starts is not None:
        first, samples = starts.states, starts.count
        head, lifted = first_samples(trajectories, samples), jnp.asarray(starts.lifted)
        linear = linearise_driven(posterior.free, theta, lifted, head, FixedStep())
        by_parameter = -np.asarray(linear.start_rows)[:, :, :known]
        factors = np.asarray(linear.start_factor)
        spread = noise**2 * _inverses(np.swapaxes(factors, 1, 2) @ factors)
    rows = []
    # One trajectory after the other, so that those of equal length compile once.
    for index, driven in enumerate(driven_models(posterior.free, theta, trajectories)):
        start, times = map(on_device, (first[index], trajectories.times[index]))
        ys, columns = linear_rollout(driven, theta, start, times, FixedStep())
        joint = np.concatenate([np.eye(known), by_parameter[index]])
        joint = joint @ posterior.covariance @ joint.T
        joint[known:, known:] += spread[index]
        slopes, path = np.asarray(columns)[..., :-1], np.asarray(ys)
        with np.errstate(over="ignore", invalid="ignore"):  # of one that diverged
            variance = np.maximum(np.sum((slopes @ joint) * slopes, axis=-1), 0.0)
        if wandering is not None:
            piece = trajectories.trajectory(index)
            inner = slice(len(piece.times))
            variance[inner] += wandering_variance(
                driven(theta), wandering, piece, path[inner], samples
            )
        rows.append((path, np.sqrt(variance)))
    return Bands(*map(np.stack, zip(*rows, strict=True)))


def _inverses(
    matrices: Float[np.ndarray, "many state state"],
) -> Float[np.ndarray, "many state state"]:
    """Inverses, NaN where a matrix is not finite or singular."""
    usable = np.isfinite(matrices).all(axis=(1, 2))
    inverses = np.full(matrices.shape, np.nan)
    inverses[usable] = np.linalg.pinv(matrices[usable], hermitian=True)
    return inverses


def inside_band(
    errors: Float[np.ndarray, "*shape"], sd: Float[np.ndarray, "*shape"]
) -> Bool[np.ndarray, "*shape"]:
    """Errors that lie inside the nominal 95 % band; what is not finite does not."""
    usable = np.isfinite(errors) & np.isfinite(sd)
    inside = np.abs(np.where(usable, errors, 0.0)) <= normal_quantile() * np.where(
        usable, sd, 0.0
    )
    return usable & inside


def fraction_inside(
    inside: Bool[np.ndarray, "*shape"], counted: Bool[np.ndarray, "*shape"]
) -> float:
    """Fraction of the counted entries that are inside; NaN where none is counted."""
    return float(inside[counted].mean()) if counted.any() else float("nan")


def force_coverage(
    learned: FieldMap,
    true: FieldMap,
    sd: Float[np.ndarray, "rows columns 2"],
    regions: dict[str, Bool[np.ndarray, "rows columns"]],
) -> dict[str, float]:
    """Fraction of the true force's components inside the band, in each region."""
    inside = inside_band(learned.force - true.force, sd)
    return {
        name: fraction_inside(inside, np.repeat(mask[..., None], 2, axis=-1))
        for name, mask in regions.items()
    }


def rollout_coverage(
    bands: Bands,
    trajectories: Trajectories,
    noise: float,
    regions: dict[str, Bool[np.ndarray, "trajectory time"]],
) -> dict[str, float]:
    """Fraction of the observed values inside the band, by where they were observed."""
    errors = bands.ys - trajectories.states
    inside = inside_band(errors, bands.observable_sd(noise))
    counted = trajectories.observed
    return {
        name: fraction_inside(inside, counted & mask[..., None])
        for name, mask in regions.items()
    }
