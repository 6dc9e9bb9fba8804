r"""Coverage: the fraction of errors that lie inside the bands of a fit.

To first order a predicted state depends on the parameters $\theta$ and the start s as
$\delta y = J\,\delta\theta + \Phi\,\delta s$. A start estimated from the first samples
depends on the parameters too, $\delta s = S\,\delta\theta + \epsilon$ with $\epsilon$
the noise of those samples, so that

$$\mathrm{Cov}\,y = (J + \Phi S)\,C\,(J + \Phi S)^\top + \Phi\,\Sigma_s\,\Phi^\top,$$

$\Sigma_s = \sigma^2 (\Phi^\top\Phi)^{-1}$ over those samples. What is observed has the
noise $\sigma$ on top. A wandering velocity adds its own variance
(`pinav.evaluation.process_noise`).
"""

from statistics import NormalDist

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from pinav.arguments import on_device
from pinav.dynamics import FixedStep
from pinav.evaluation.force_fields import FieldMap
from pinav.evaluation.process_noise import wandering_variance
from pinav.evaluation.starts import (
    DrivenModel,
    Starts,
    driven_models,
    first_samples,
    linearise_driven,
)
from pinav.fitting import Posterior
from pinav.fitting.engine.multiple_shooting import sensitivities
from pinav.systems import WanderingVelocity
from pinav.trajectories import Trajectories

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
    """Predicted states and their standard deviations, observation noise apart.

    Attributes:
        ys: predicted states; not finite once diverged.
    """

    ys: Float[np.ndarray, "trajectory time state"]
    sd: Float[np.ndarray, "trajectory time state"]

    def observable_sd(self, noise: float) -> Float[np.ndarray, "trajectory time state"]:
        """Standard deviation of what is observed with this noise."""
        return np.sqrt(self.sd**2 + noise**2)


def exact_start_bands(
    posterior: Posterior,
    trajectories: Trajectories,
    solver: FixedStep | None = None,
    *,
    start_sd: float = 0.0,
    wandering: WanderingVelocity | None = None,
) -> Bands:
    """Bands of rollouts from the first samples, which are exact unless said otherwise.

    Args:
        trajectories: where to start and when to predict.
        start_sd: standard deviation of each first sample.
        wandering: velocity of the swimmer that the model leaves out.
    """
    states = trajectories.states.shape[2]
    by_parameter = np.zeros((len(trajectories), states, len(posterior.mean)))
    spread = np.tile(start_sd**2 * np.eye(states), (len(trajectories), 1, 1))
    starts = trajectories.states[:, 0]
    bands = _bands(posterior, trajectories, starts, by_parameter, spread, solver)
    return _widen(bands, posterior, trajectories, wandering, 1)


def estimated_start_bands(
    posterior: Posterior,
    trajectories: Trajectories,
    starts: Starts,
    noise: float,
    solver: FixedStep | None = None,
    *,
    wandering: WanderingVelocity | None = None,
) -> Bands:
    """Bands of rollouts from estimated starts.

    Args:
        trajectories: when to predict.
        starts: the estimates.
        wandering: velocity of the swimmer that the model leaves out.
    """
    head = first_samples(trajectories, starts.count)
    linear = linearise_driven(
        posterior.free,
        jnp.asarray(posterior.mean),
        jnp.asarray(starts.lifted),
        head,
        FixedStep() if solver is None else solver,
    )
    rows = -np.asarray(linear.start_rows)[:, :, : len(posterior.mean)]
    factors = np.asarray(linear.start_factor)
    spread = noise**2 * _inverses(np.swapaxes(factors, 1, 2) @ factors)
    bands = _bands(posterior, trajectories, starts.states, rows, spread, solver)
    return _widen(bands, posterior, trajectories, wandering, starts.count)


def _widen(
    bands: Bands,
    posterior: Posterior,
    trajectories: Trajectories,
    wandering: WanderingVelocity | None,
    count: int,
) -> Bands:
    """The bands with the variance that a wandering velocity adds."""
    if wandering is None:
        return bands
    theta, variance = jnp.asarray(posterior.mean), bands.sd**2
    models = driven_models(posterior.free, theta, trajectories)
    each = zip(models, trajectories, bands.ys, variance, strict=True)
    for driven, piece, path, row in each:
        length = len(piece.times)
        row[:length] += wandering_variance(
            driven(theta), wandering, piece, path[:length], count
        )
    return Bands(bands.ys, np.sqrt(variance))


def _inverses(
    matrices: Float[np.ndarray, "many state state"],
) -> Float[np.ndarray, "many state state"]:
    """Inverses, NaN where a matrix is not finite or singular."""
    usable = np.isfinite(matrices).all(axis=(1, 2))
    inverses = np.full(matrices.shape, np.nan)
    inverses[usable] = np.linalg.pinv(matrices[usable], hermitian=True)
    return inverses


def _bands(
    posterior: Posterior,
    trajectories: Trajectories,
    starts: Float[np.ndarray, "trajectory state"],
    by_parameter: Float[np.ndarray, "trajectory state parameter"],
    spread: Float[np.ndarray, "trajectory state state"],
    solver: FixedStep | None,
) -> Bands:
    """One trajectory after the other, so that those of equal length compile once."""
    solver = FixedStep() if solver is None else solver
    theta, covariance = map(on_device, (posterior.mean, posterior.covariance))
    models = driven_models(posterior.free, theta, trajectories)
    each = zip(starts, by_parameter, spread, trajectories.times, strict=True)
    rows = [
        _linear_band(driven, theta, covariance, tuple(map(on_device, start)), solver)
        for driven, start in zip(models, each, strict=True)
    ]
    ys, sd = (np.stack(part) for part in zip(*rows, strict=True))
    return Bands(ys, sd)


@eqx.filter_jit
def _linear_band(
    driven: DrivenModel,
    theta: Float[Array, " parameter"],
    covariance: Float[Array, "parameter parameter"],
    start: tuple[Array, ...],
    solver: FixedStep,
) -> tuple[Float[Array, "time state"], Float[Array, "time state"]]:
    y0, by_parameter, spread, times = start
    ys, _ = solver.solve(driven(theta), y0, times)
    columns = sensitivities(driven, theta, ys, times, solver).columns
    to_start = columns[..., len(theta) : -1]
    total = columns[..., : len(theta)] + to_start @ by_parameter
    variance = jnp.sum((total @ covariance) * total, axis=-1)
    variance += jnp.sum((to_start @ spread) * to_start, axis=-1)
    return ys, jnp.sqrt(jnp.maximum(variance, 0.0))


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
    """Fraction of the observed values inside the band, by where they were observed.

    Args:
        trajectories: what was observed; only that counts.
        regions: which samples lie in each region.
    """
    errors = bands.ys - trajectories.states
    inside = inside_band(errors, bands.observable_sd(noise))
    counted = trajectories.observed
    return {
        name: fraction_inside(inside, counted & mask[..., None])
        for name, mask in regions.items()
    }
