r"""Laws refitted through the equations of motion, on the trajectories themselves.

Residuals of observations are independent, those of a learned field are not: here the
likelihood, and so the comparison of laws and their intervals, is exact.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.special
from jaxtyping import Float

from pinav.analysis.discovery.law_regression import MISFIT_PROBABILITY, Values
from pinav.dynamics import FixedStep, OverdampedSwimmer, Swimmer, with_dtype
from pinav.errors import FitError, InputError
from pinav.fitting import Outcome, Posterior
from pinav.fitting.bayes.problem import BayesProblem, LocalTrajectories
from pinav.fitting.engine.evidence_fit import iterate
from pinav.fitting.engine.local_model import ParametricModel, ravel_model
from pinav.fitting.matching.state import Trainable
from pinav.forces.law_force import LawForce
from pinav.forces.laws import AbstractLaw
from pinav.trajectories import Trajectories, with_velocities

MAX_ITERATIONS = 40

TOLERANCE = 1e-4
"""Change of the log evidence at which a refit ends."""

SINGULAR = 1e-12
"""Relative eigenvalue of the scaled normal matrix that counts as zero."""

ROUNDING = 1e-10
"""Root-mean-square residual, relative to the states, below which all fits are equal."""


class Refit(eqx.Module):
    r"""A law refitted on trajectories.

    Attributes:
        covariance: their covariance; infinite in directions the data say nothing of.
        noise: $\sigma$ of the observations, estimated.
        outcome: what was reached when the refit stalled or diverged is not a best fit.
    """

    law: AbstractLaw = eqx.field(static=True)
    constants: Values
    covariance: Float[np.ndarray, "constant constant"]
    squares: float
    noise: float
    num_residuals: int
    outcome: Outcome = eqx.field(static=True)

    @property
    def bic(self) -> float:
        r"""$n \log(\sum r^2/n) + k \log n$; infinite where the refit diverged."""
        if self.outcome is Outcome.DIVERGED or not self.squares > 0:
            return np.inf
        count = self.num_residuals
        mean = self.squares / count
        return float(count * np.log(mean) + len(self.constants) * np.log(count))


def refit(
    law: AbstractLaw,
    constants: Values,
    model: Swimmer | OverdampedSwimmer,
    learned: "LearnedOnPaths",
) -> Refit:
    """The fit of a law to trajectories, from the states of a learned force.

    Where the data leave the constants open, they stay as they are.
    """
    outcome = Outcome.DIVERGED
    with jax.enable_x64(new_val=True):
        environment = LawForce(law, jnp.asarray(constants, jnp.float64))
        swimmer = model.with_environment(environment)
        try:
            problem = BayesProblem.of(
                swimmer,
                learned.trajectories,
                lambda model: model.environment.constants,
                None,
                FixedStep(),
                states=learned.states,
            )
            problem = dataclasses.replace(problem, tolerance=TOLERANCE)
            outcome, steps = iterate(problem, MAX_ITERATIONS)
            move = steps[-1].move if steps else None
            local = move and problem.linearise(move.theta, move.states)
        except (FitError, InputError):
            local = None
    if local is None:
        lost = np.diag(np.full(len(constants), np.inf))
        count, outcome = learned.num_residuals, Outcome.DIVERGED
        return Refit(law, constants, lost, np.inf, np.inf, count, outcome)
    best, count = local.quadratic, local.quadratic.num_free
    squares = max(best.squares, count * (ROUNDING * learned.scale) ** 2)
    variance = squares / max(count - len(best.point), 1)
    covariance, noise = variance * _inverse(best.hessian), float(np.sqrt(variance))
    return Refit(law, best.point, covariance, squares, noise, count, outcome)


def _inverse(
    hessian: Float[np.ndarray, "constant constant"],
) -> Float[np.ndarray, "constant constant"]:
    """The inverse; infinite variances where the matrix is singular."""
    root = np.sqrt(np.maximum(np.diag(hessian), 0.0))
    if not np.all(np.isfinite(root)) or not np.all(root > 0):
        return np.diag(np.full(len(root), np.inf))
    values, vectors = np.linalg.eigh(hessian / np.outer(root, root))
    kept = values > SINGULAR * values[-1]
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    lost = np.sum(vectors[:, ~kept] ** 2, axis=1) > 1e-6
    inverse = inverse / np.outer(root, root)
    inverse[lost, lost] = np.inf
    return inverse


class LearnedOnPaths(eqx.Module):
    """A learned force held against the trajectories once more.

    Attributes:
        states: that fulfil its dynamics.
        extent: longest side of the box around their positions [L].
        scale: largest spread of a channel.
        num_residuals: observations less starts.
    """

    trajectories: Trajectories
    states: Float[np.ndarray, "trajectory time state"]
    extent: float
    scale: float
    num_residuals: int
    squares: float
    noise: float
    num_effective: float

    @classmethod
    def of(cls, posterior: Posterior, trajectories: Trajectories) -> "LearnedOnPaths":
        """States that fulfil the dynamics of the mean model; FitError without any."""
        local = _linearise(posterior.free, posterior.mean, trajectories)
        states, quadratic = np.asarray(local.states), local.quadratic
        squares, count = quadratic.squares, quadratic.num_free
        # the noise and the number of parameters depend on each other
        information = np.sum(quadratic.hessian * posterior.covariance)
        ceiling = min(float(len(posterior.mean)), 0.5 * count)
        effective, noise = ceiling, 0.0
        for _ in range(50):
            noise = np.sqrt(max(squares, 1e-300) / max(count - effective, 1.0))
            effective = float(np.clip(information / noise**2, 1.0, ceiling))
        return cls(
            trajectories=trajectories,
            states=states,
            extent=float(np.ptp(states[..., :2].reshape(-1, 2), axis=0).max()),
            scale=float(local.problem.scale.max()),
            num_residuals=count,
            squares=squares,
            noise=float(noise),
            num_effective=effective,
        )

    def is_explained_by(self, law: Refit) -> bool:
        """True if the misfit that a law adds is what chance may add."""
        if law.outcome is Outcome.DIVERGED:
            return False
        excess = (law.squares - self.squares) / self.noise**2
        chance = scipy.special.chdtrc(max(self.num_effective, 1.0), max(excess, 0.0))
        return bool(chance > MISFIT_PROBABILITY)


def laplace_posterior(
    model: Swimmer | OverdampedSwimmer, trajectories: Trajectories, trainable: Trainable
) -> Posterior:
    """The Laplace posterior of a fit that has none, such as a least-squares fit.

    The prior of the parameters is normal about zero, as wide as their root mean
    square; the noise is that of the residuals.

    Raises:
        FitError: the learned force does not explain the trajectories.
    """
    if isinstance(model, Swimmer):
        trajectories = with_velocities(trajectories)
    with jax.enable_x64(new_val=True):
        free, theta = ravel_model(with_dtype(model, jnp.float64), trainable)
    local = _linearise(free, np.asarray(theta), trajectories).quadratic
    values, vectors = np.linalg.eigh(local.hessian)
    values = np.maximum(values, 0.0)
    width = float(np.sqrt(np.mean(local.point**2))) or 1.0
    count, noise = local.num_free, 0.0
    variance = np.full_like(values, width**2)
    for _ in range(20):
        variance = 1.0 / (values / max(noise**2, 1e-300) + width**-2)
        used = min(float(np.sum(1.0 - variance / width**2)), 0.5 * count)
        noise = np.sqrt(max(local.squares, 1e-300) / (count - used))
    return Posterior(free, local.point, (vectors * variance) @ vectors.T)


def _linearise(
    free: ParametricModel,
    theta: Float[np.ndarray, " parameter"],
    trajectories: Trajectories,
) -> LocalTrajectories:
    """The model about states that fulfil its dynamics; FitError without any."""
    with jax.enable_x64(new_val=True):
        known = BayesProblem.of(free.at(theta), trajectories, None, None, FixedStep())
        problem = dataclasses.replace(known, parametric=free)
        local = problem.linearise(theta, problem.states)
        for _ in range(6):
            if local is None or local.defect(theta, 0.0) < 1e-9:
                break
            local = problem.linearise(theta, local.advance(theta))
        if not isinstance(local, LocalTrajectories) or local.defect(theta, 0.0) > 1e-3:
            raise FitError(
                "law discovery: the learned force does not explain the "
                "trajectories; fit it to them first"
            )
        return local
