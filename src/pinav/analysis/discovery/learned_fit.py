"""The learned force on the trajectories: what a law has to explain as well."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.special
from jaxtyping import Float

from pinav.analysis.discovery.refit import LinearisedModel, Refit, RefitProblem
from pinav.dynamics import FixedStep, OverdampedSwimmer, Swimmer, with_dtype
from pinav.errors import FitError
from pinav.fitting import Outcome, Posterior
from pinav.fitting.engine.parametric_model import ParametricModel, ravel_model
from pinav.fitting.matching.trainable import Trainable
from pinav.trajectories import Trajectories, smooth_states, with_velocities

MISFIT_PROBABILITY = 1e-3
"""A law fits if it leaves a misfit that chance makes more often than this."""


class Learned(eqx.Module):
    """A learned force held against the trajectories once more.

    Attributes:
        problem: the trajectories, linearised about the smoothed states.
        squares: sum of squared residuals.
        noise: standard deviation of the observations.
        num_effective: parameters that the data, not the prior, determine.
    """

    problem: RefitProblem
    squares: float
    noise: float
    num_effective: float

    @classmethod
    def of(
        cls, posterior: Posterior, trajectories: Trajectories, solver: FixedStep
    ) -> "Learned":
        """Linearise the mean model about states that fulfil its dynamics.

        Raises:
            FitError: no such states were found.
        """
        problem, local = _linearise(
            posterior.free, posterior.mean, trajectories, solver
        )
        hessian = local.hessian
        squares, count = local.squares, problem.num_residuals
        # the noise and the number of parameters depend on each other
        information = np.sum(hessian * posterior.covariance)
        effective = min(float(len(posterior.mean)), 0.5 * count)
        noise = 0.0
        for _ in range(50):
            noise = np.sqrt(max(squares, 1e-300) / max(count - effective, 1.0))
            ceiling = min(float(len(posterior.mean)), 0.5 * count)
            effective = float(np.clip(information / noise**2, 1.0, ceiling))
        return cls(problem, squares, float(noise), effective)

    def is_explained_by(self, law: Refit) -> bool:
        """Whether the misfit that a law adds is what chance may add."""
        if law.outcome is Outcome.DIVERGED:
            return False
        excess = (law.squares - self.squares) / self.noise**2
        chance = scipy.special.chdtrc(max(self.num_effective, 1.0), max(excess, 0.0))
        return bool(chance > MISFIT_PROBABILITY)


def laplace_posterior(
    model: Swimmer | OverdampedSwimmer,
    trajectories: Trajectories,
    trainable: Trainable,
    *,
    solver: FixedStep | None = None,
) -> Posterior:
    """The Laplace posterior of a fit that has none, such as a least-squares fit.

    The prior of the parameters is normal about zero, as wide as their root mean
    square; the noise is that of the residuals.

    Args:
        model: fitted.
        trajectories: those that it was fitted to.
        trainable: selects its fitted parameters.
        solver: steps between samples; `FixedStep()` unless given.

    Raises:
        FitError: the learned force does not explain the trajectories.
    """
    solver = FixedStep() if solver is None else solver
    if isinstance(model, Swimmer):
        trajectories = with_velocities(trajectories)
    with jax.enable_x64(new_val=True):
        free, theta = ravel_model(with_dtype(model, jnp.float64), trainable)
    problem, local = _linearise(free, np.asarray(theta), trajectories, solver)
    values, vectors = np.linalg.eigh(local.hessian)
    values = np.maximum(values, 0.0)
    width = float(np.sqrt(np.mean(local.theta**2))) or 1.0
    count, noise = problem.num_residuals, 0.0
    variance = np.full_like(values, width**2)
    for _ in range(20):
        variance = 1.0 / (values / max(noise**2, 1e-300) + width**-2)
        used = min(float(np.sum(1.0 - variance / width**2)), 0.5 * count)
        noise = np.sqrt(max(local.squares, 1e-300) / (count - used))
    return Posterior(free, local.theta, (vectors * variance) @ vectors.T)


def _linearise(
    free: ParametricModel,
    theta: Float[np.ndarray, " parameter"],
    trajectories: Trajectories,
    solver: FixedStep,
) -> tuple[RefitProblem, LinearisedModel]:
    """A model about states that fulfil its dynamics, the problem about them too."""
    with jax.enable_x64(new_val=True):
        states = smooth_states(trajectories, trajectories.dim)
        problem = RefitProblem.of(trajectories, states, solver)
        start = LinearisedModel.at(free, theta, problem.states, problem)
        local = problem.close_defects(start)
        if not local.is_finite or problem.defect(local) > 1e-3:
            raise FitError(
                "law discovery: the learned force does not explain the "
                "trajectories; fit it to them first"
            )
        return eqx.tree_at(lambda p: p.states, problem, np.asarray(local.states)), local
