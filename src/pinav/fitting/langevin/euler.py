r"""Euler and Maruyama's likelihood: exact positions, short steps, one diffusion.

Without inertia $dX = (u + M F)\,dt + \sqrt{2D}\,dW$. From one observation to the next
an increment is nearly normal about the drift: divided by $\sqrt{\Delta t}$, all have
the variance 2D, and kernels are linear in their weights. So the evidence chooses prior
and diffusion as `fit_bayes` chooses prior and noise.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pinav.dynamics import OverdampedSwimmer, with_dtype
from pinav.fitting.engine.evidence_fit import EvidenceFit, evidence_fit
from pinav.fitting.engine.posterior import Estimate
from pinav.fitting.engine.problem import Step
from pinav.fitting.engine.steps import FullStep
from pinav.fitting.environments.refinement import Refinement, iterate_refined
from pinav.fitting.evidence.evidence import LinearisedObservations
from pinav.fitting.evidence.shape_mixture import mix_shapes
from pinav.fitting.evidence.weights import GaussianWeights
from pinav.fitting.langevin.increments import Increments
from pinav.fitting.least_squares import Regression
from pinav.trajectories import Trajectories


def fit_euler(
    swimmer: OverdampedSwimmer,
    trajectories: Trajectories,
    increments: Increments,
    diffusion: float | None,
    refine: Refinement | None,
) -> EvidenceFit:
    """Fit the force, and one diffusion coefficient unless it is known.

    Args:
        swimmer: its environment is made of kernels.
        trajectories: around which kernels are laid.
        increments: of the paths.
        diffusion: D [L² T⁻¹] where it is known.
        refine: when kernels turn out too coarse.
    """
    noise = None if diffusion is None else float(np.sqrt(2 * diffusion))

    def begin(model: OverdampedSwimmer, states: None = None) -> Regression:
        environment: Any = model.environment
        return Regression.of(
            without_weights(model),
            increments,
            weights=lambda m: m.environment.parameters,
            weights_prior=GaussianWeights(environment.prior()),
            noise=noise,
            step_rule=FullStep(),
            is_linear=True,
            log_determinant=increments.log_determinant,
        )

    with jax.enable_x64(new_val=True):
        problem = begin(with_dtype(swimmer, jnp.float64))
        ended = iterate_refined(problem, begin, refine, trajectories, max_iterations=1)
        fit = mix_over_shapes(evidence_fit(*ended, not_finite=NOT_FINITE, advice={}))
    return eqx.tree_at(
        lambda f: f.constants, fit, {"diffusion": _diffusion(ended[2][-1], diffusion)}
    )


NOT_FINITE = "its drift is not finite at the observed positions; check the known forces"


def without_weights(model: OverdampedSwimmer) -> OverdampedSwimmer:
    """The model with an environment whose weights are zero.

    The regression is linear: it is solved about zero, where no digits cancel.
    """
    environment: Any = model.environment
    zeros = jax.tree.map(jnp.zeros_like, environment.parameters)
    return eqx.tree_at(lambda m: m.environment.parameters, model, zeros)


def _diffusion(step: Step, known: float | None) -> Estimate:
    """Diffusion from the noise; its deviation from the degrees of freedom left."""
    if known is not None:
        return Estimate(known, 0.0)
    variance = step.hyperparameters.noise**2
    # Each direction that the data determine takes one observation from the variance.
    left = max(step.quadratic.num_free - step.num_determined, 1.0)
    return Estimate(variance / 2, variance / 2 * float(np.sqrt(2 / left)))


MOST_WEIGHTS = 800
"""Weights up to which shapes are mixed: each of 200 asks for a decomposition."""


def mix_over_shapes(fit: EvidenceFit) -> EvidenceFit:
    """The fit whose force is the mean over all shapes, with the bands of them all.

    Forces with more than `MOST_WEIGHTS` weights keep the best shape, and a normal
    distribution about it: so many are laid only where the data tell the shape.

    Args:
        fit: linear in its weights, with nothing else to learn.
    """
    weights = fit.linear.weights
    few = len(fit.posterior.mean) <= MOST_WEIGHTS
    if not (few and isinstance(weights, GaussianWeights)):
        return fit
    data = LinearisedObservations.of(fit.linear.quadratic)
    mixed = mix_shapes(data, weights.prior, fit.hyperparameters, fit.linear.noise)
    posterior = eqx.tree_at(
        lambda p: (p.mean, p.covariance), fit.posterior, (mixed.mean, mixed.covariance)
    )
    return eqx.tree_at(
        lambda f: (f.posterior, f.model), fit, (posterior, posterior.model)
    )
