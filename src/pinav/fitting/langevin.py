r"""`fit_langevin`: an environment from paths that thermal noise kicks.

Without inertia $dX = (u + M F)\,dt + \sqrt{2D}\,dW$. From one observation to the next
an increment is nearly normal about the drift (Euler and Maruyama): divided by
$\sqrt{\Delta t}$, all have the variance 2D, and kernels are linear in their weights. So
the evidence chooses prior and diffusion as `fit_bayes` chooses prior and noise.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.dynamics import (
    AbstractDynamics,
    BrownianSwimmer,
    OverdampedSwimmer,
    with_dtype,
)
from pinav.errors import InputError
from pinav.fitting.bayes.parameters import learned_environment
from pinav.fitting.engine.evidence_fit import EvidenceFit
from pinav.fitting.engine.multiple_shooting import ravel_model
from pinav.fitting.engine.posterior import Estimate, Posterior
from pinav.fitting.environments.refinement import AS_FINE_AS_ASKED, Refinement
from pinav.fitting.evidence.model_evidence import LinearFit
from pinav.fitting.evidence.quadratic import Quadratic
from pinav.fitting.evidence.weights import GaussianWeights
from pinav.fitting.outcome import Outcome
from pinav.trajectories import Trajectories


class Increments(eqx.Module):
    r"""Displacements between observed samples that follow one another.

    Attributes:
        times: at the start of each [T].
        positions: there [L].
        steps: displacement [L].
        intervals: duration [T].
    """

    times: Float[np.ndarray, " increment"]
    positions: Float[np.ndarray, "increment dim"]
    steps: Float[np.ndarray, "increment dim"]
    intervals: Float[np.ndarray, " increment"]

    @classmethod
    def of(cls, trajectories: Trajectories) -> "Increments":
        """All increments; one spans the gap where samples are missing.

        Raises:
            InputError: no trajectory has two samples with all positions observed.
        """
        parts = []
        for piece in trajectories:
            seen = piece.observed.all(axis=1)
            times, positions = piece.times[seen], piece.states[seen]
            row = times[:-1], positions[:-1], np.diff(positions, axis=0), np.diff(times)
            parts.append(row)
        times, positions, steps, intervals = map(
            np.concatenate, zip(*parts, strict=True)
        )
        if not len(times):
            raise InputError(
                "fit_langevin trajectories: expected two or more samples with all "
                "positions observed in one of them, got none"
            )
        return cls(times, positions, steps, intervals)


def fit_langevin(
    model: AbstractDynamics,
    trajectories: Trajectories,
    *,
    diffusion: float | None = None,
    refine: Refinement | None = AS_FINE_AS_ASKED,
) -> EvidenceFit:
    r"""Fit the force, and the diffusion coefficient, to stochastic paths.

    The likelihood is that of Euler and Maruyama's scheme with one step from sample to
    sample: intervals must be short against the time in which the force changes. Its
    bias in D is about $\Delta t\,\partial(MF)/\partial x$, relative. Positions must be
    exact against $\sqrt{2 D \Delta t}$: a localisation error $s$ is not modelled, and
    adds about $s^2/\Delta t$ to D. Diffusion is one number: isotropic and the same
    everywhere. Times may be irregular and samples missing.

    Args:
        model: an `OverdampedSwimmer`, or a `BrownianSwimmer` that has one; its
            environment is made of kernels, its mobility turns velocities into forces.
        trajectories: their channels are the positions.
        diffusion: $D$ [L² T⁻¹] where it is known; estimated unless given.
        refine: when kernels turn out too coarse, and finer ones are laid; None keeps
            them.

    Raises:
        InputError: the model is none of these, its environment is not linear in its
            weights, the channels are not its positions, there are no increments, or
            `diffusion` is not positive.

    References:
        Frishman and Ronceray, Phys. Rev. X 10, 021009 (2020); Kloeden and Platen,
        Numerical Solution of Stochastic Differential Equations (1992).
    """
    swimmer = _checked(model, trajectories, diffusion)
    increments = Increments.of(trajectories)
    noise = None if diffusion is None else float(np.sqrt(2 * diffusion))
    with jax.enable_x64(new_val=True):
        exact = with_dtype(swimmer, jnp.float64)
        outcome = Outcome.CONVERGED
        while True:
            free, quadratic, weights, found = _inferred(exact, increments, noise)
            chosen = found.hyperparameters
            coarse: Any = exact.environment
            if refine is None or not refine.wanted(coarse, chosen.shape):
                break
            finer = refine.finer(coarse, trajectories)
            if finer is None:
                outcome = Outcome.UNDER_RESOLVED
                break
            exact = exact.with_environment(finer)
        extra = weights.shape_covariance(quadratic, chosen, noise)
        posterior = Posterior(free, found.mean, found.covariance + extra)
        fitted = posterior.model
    return EvidenceFit(
        model=fitted,
        outcome=outcome,
        iterations=1,
        constants={"diffusion": _diffusion(quadratic, found, diffusion)},
        states=None,
        hyperparameters=chosen,
        posterior=posterior,
        linear=LinearFit(
            quadratic, weights, noise, quadratic.num_free, quadratic.log_determinant
        ),
    )


def _inferred(swimmer: OverdampedSwimmer, increments: "Increments", noise):
    """The weights on the kernels as they are, and what they were inferred from."""
    free, theta = ravel_model(swimmer, lambda m: m.environment.parameters)
    quadratic = _regression(free, jnp.zeros_like(theta), increments)
    environment: Any = swimmer.environment
    weights = GaussianWeights(environment.prior())
    return free, quadratic, weights, weights.infer(quadratic, weights.start, noise)


def _regression(free, theta, increments: Increments) -> Quadratic:
    r"""Sum of squares of $(\Delta x - \text{drift}\,\Delta t) / \sqrt{\Delta t}$."""
    root = np.sqrt(increments.intervals)[:, None]
    times, positions = jnp.asarray(increments.times), jnp.asarray(increments.positions)
    drift, slopes = map(np.asarray, _drift(free, theta, times, positions))
    residuals = (drift * root - increments.steps / root).reshape(-1)
    rows = (slopes * root[..., None]).reshape(len(residuals), -1)
    return Quadratic(
        point=np.asarray(theta),
        hessian=rows.T @ rows,
        gradient=rows.T @ residuals,
        squares=float(residuals @ residuals),
        num_free=len(residuals),
        log_determinant=float(2 * np.log(root).sum() * increments.steps.shape[1]),
    )


@eqx.filter_jit
def _drift(free, theta, times, positions):
    """Drift at each point, and its derivative by the weights."""

    def at(theta, t, x):
        return free(theta)(t, x)

    axes = (None, 0, 0)
    drift = jax.vmap(at, axes)(theta, times, positions)
    return drift, jax.vmap(jax.jacrev(at), axes)(theta, times, positions)


def _diffusion(quadratic, found, known: float | None) -> Estimate:
    """Diffusion from the noise; its deviation from the degrees of freedom left."""
    if known is not None:
        return Estimate(known, 0.0)
    variance = found.hyperparameters.noise**2
    used = float(np.sum(quadratic.hessian * found.covariance)) / variance
    free = max(quadratic.num_free - used, 1.0)
    return Estimate(variance / 2, variance / 2 * float(np.sqrt(2 / free)))


def _checked(model, trajectories, diffusion) -> OverdampedSwimmer:
    swimmer = model.swimmer if isinstance(model, BrownianSwimmer) else model
    if not isinstance(swimmer, OverdampedSwimmer):
        raise InputError(
            "fit_langevin model: expected a swimmer without inertia, got "
            f"{type(model).__name__}; for Swimmer use fit_bayes"
        )
    environment = learned_environment(swimmer)
    if environment is None or not environment.is_linear:
        raise InputError(
            "fit_langevin model: expected an environment made by kernel_environment, "
            f"got {type(swimmer.environment).__name__}"
        )
    dim = environment.dim
    if len(trajectories.channels) != dim:
        raise InputError(
            f"fit_langevin trajectories: expected {dim} channels, positions alone, got "
            f"{', '.join(trajectories.channels)}"
        )
    if diffusion is not None and not 0 < diffusion < np.inf:
        raise InputError(
            f"fit_langevin diffusion: expected a finite number > 0, got {diffusion}; "
            "leave it out to estimate it"
        )
    return swimmer
