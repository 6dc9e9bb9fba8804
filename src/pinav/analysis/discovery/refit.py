r"""Laws refitted through the equations of motion, on the trajectories themselves.

Residuals of observations are independent, those of a learned field are not: here the
likelihood, and so the comparison of laws and their intervals, is exact.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.special
from jaxtyping import Array, Float

from pinav.analysis.discovery.law_regression import MISFIT_PROBABILITY
from pinav.dynamics import FixedStep, OverdampedSwimmer, Swimmer, with_dtype
from pinav.errors import FitError
from pinav.fitting import Outcome, Posterior
from pinav.fitting.engine.local_model import ParametricModel, ravel_model
from pinav.fitting.engine.multiple_shooting import Linearisation, advance, linearise
from pinav.fitting.matching.state import Observations, Trainable
from pinav.forces.formulas import Role
from pinav.forces.laws import AbstractLaw, LawForce
from pinav.trajectories import Trajectories, smooth_states, with_velocities

MAX_ITERATIONS = 40
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
    constants: Float[np.ndarray, " constant"]
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


class LinearisedModel(eqx.Module):
    """A model linearised about states that need not solve it, the starts eliminated."""

    parametric: ParametricModel
    theta: Float[np.ndarray, " parameter"]
    states: Float[Array, "trajectory time state"]
    linear: Linearisation
    hessian: Float[np.ndarray, "parameter parameter"]

    @classmethod
    def at(
        cls,
        parametric: ParametricModel,
        theta: Float[Any, " parameter"],
        states: Float[Any, "trajectory time state"],
        problem: "RefitProblem",
    ) -> "LinearisedModel":
        """Linearise about constants and states."""
        inputs = jnp.asarray(theta), jnp.asarray(states)
        linear = linearise(parametric, *inputs, problem.observations, FixedStep())
        hessian = np.asarray(linear.hessian)
        return cls(parametric, np.asarray(theta), inputs[1], linear, hessian)

    def after(
        self, change: Float[np.ndarray, " parameter"], problem: "RefitProblem"
    ) -> "LinearisedModel":
        """After a change of the constants, each start at its best."""
        states = advance(self.states, self.linear, jnp.asarray(change))
        return LinearisedModel.at(self.parametric, self.theta + change, states, problem)

    @property
    def squares(self) -> float:
        """Sum of the squared residuals."""
        return float(self.linear.squares)

    @property
    def is_finite(self) -> bool:
        """True if the linearisation can be used."""
        linear = self.linear
        parts = (self.hessian, linear.gradient, linear.squares, linear.start_rows)
        return all(bool(np.all(np.isfinite(part))) for part in (*parts, self.states))


class RefitProblem(eqx.Module):
    """Data and settings that all refits on the same trajectories share."""

    observations: Observations
    states: Float[np.ndarray, "trajectory time state"]
    scale: Float[np.ndarray, " state"]
    extent: float
    num_residuals: int

    @classmethod
    def of(
        cls,
        trajectories: Trajectories,
        states: Float[np.ndarray, "trajectory time state"],
    ) -> "RefitProblem":
        """The problem of `trajectories`, linearised first about `states`."""
        spread = states.reshape(-1, states.shape[-1]).std(axis=0)
        positions = states[..., :2].reshape(-1, 2)
        return cls(
            Observations.of(trajectories, jnp.float64),
            np.asarray(states),
            np.where(spread > 0, spread, 1.0),
            float(np.ptp(positions, axis=0).max()),
            trajectories.num_observed - states[:, 0].size,
        )

    def defect(self, local: LinearisedModel) -> float:
        """The largest defect, relative to the spread of its channel."""
        return float(np.max(np.asarray(local.linear.defects) / self.scale))


def refit(
    law: AbstractLaw,
    constants: Float[np.ndarray, " constant"],
    model: Swimmer | OverdampedSwimmer,
    problem: RefitProblem,
) -> Refit:
    """Least squares of a law through the dynamics, by damped local Gauss-Newton."""
    with jax.enable_x64(new_val=True):
        environment = LawForce(law, jnp.asarray(constants, jnp.float64))
        swimmer = model.with_environment(environment)
        free, theta = ravel_model(
            with_dtype(swimmer, jnp.float64), lambda m: m.environment.constants
        )
        local = LinearisedModel.at(free, theta, problem.states, problem)
        return _result(law, *_minimise(law, local, problem), problem)


def _minimise(
    law: AbstractLaw, local: LinearisedModel, problem: RefitProblem
) -> tuple[LinearisedModel, Outcome]:
    """Levenberg-Marquardt steps; a refused one still closes the defects."""
    damping = 1e-3
    if not local.is_finite:
        return local, Outcome.DIVERGED
    for _ in range(MAX_ITERATIONS):
        change, gain = _step(law, local, damping, problem.extent)
        variance = local.squares / problem.num_residuals
        small = np.all(np.abs(change) < 1e-10 * (1e-3 + np.abs(local.theta)))
        settled = gain < 1e-3 * variance or small
        if settled and problem.defect(local) < 1e-6:
            return local, Outcome.CONVERGED
        trial = local.after(change, problem)
        if trial.is_finite and trial.squares <= local.squares * (1 + 1e-12):
            local, damping = trial, max(damping / 10, 1e-12)
            continue
        closed = local.after(np.zeros(len(change)), problem)
        if not closed.is_finite or damping > 1e8:
            return local, Outcome.DIVERGED
        local, damping = closed, damping * 10
    return local, Outcome.STALLED


def _step(
    law: AbstractLaw, local: LinearisedModel, damping: float, extent: float
) -> tuple[Float[np.ndarray, " constant"], float]:
    """A damped step within reason, and the decrease of the squares it promises."""
    hessian = local.hessian
    gradient = np.asarray(local.linear.gradient)
    root = np.sqrt(np.maximum(np.diag(hessian), np.finfo(float).tiny))
    scaled = hessian / np.outer(root, root) + damping * np.eye(len(root))
    change = -np.linalg.lstsq(scaled, gradient / root, rcond=1e-13)[0] / root
    largest = np.max(np.abs(change) / _reach(law, local.theta, extent))
    change = change / max(largest, 1.0)
    return change, -float(2 * gradient @ change + change @ hessian @ change)


def _reach(
    law: AbstractLaw, theta: Float[np.ndarray, " constant"], extent: float
) -> Float[np.ndarray, " constant"]:
    """Largest change of each constant in one step."""
    size = np.abs(theta)
    by_role = {
        Role.AMPLITUDE: size + 0.5 * size.max(),
        Role.POSITION: np.full(len(theta), 0.3 * extent),
        Role.SCALE: 0.5 * size,
        Role.ANGLE: np.full(len(theta), 0.3),
    }
    return np.array([by_role[c.role][i] for i, c in enumerate(law.constants)])


def _result(
    law: AbstractLaw, local: LinearisedModel, outcome: Outcome, problem: RefitProblem
) -> Refit:
    count = problem.num_residuals
    free = max(count - len(local.theta), 1)
    least = count * (ROUNDING * float(problem.scale.max())) ** 2
    squares = max(local.squares, least)
    variance = squares / free
    return Refit(
        law=law,
        constants=local.theta,
        covariance=variance * _inverse(local.hessian),
        squares=squares,
        noise=float(np.sqrt(variance)),
        num_residuals=count,
        outcome=outcome,
    )


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
    """A learned force held against the trajectories once more."""

    problem: RefitProblem
    squares: float
    noise: float
    num_effective: float

    @classmethod
    def of(cls, posterior: Posterior, trajectories: Trajectories) -> "LearnedOnPaths":
        """States that fulfil the dynamics of the mean model; FitError without any."""
        problem, local = _linearise(posterior.free, posterior.mean, trajectories)
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
    problem, local = _linearise(free, np.asarray(theta), trajectories)
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
) -> tuple[RefitProblem, LinearisedModel]:
    """The model about states that fulfil its dynamics; FitError without any."""
    with jax.enable_x64(new_val=True):
        states = smooth_states(trajectories, trajectories.dim)
        problem = RefitProblem.of(trajectories, states)
        local = LinearisedModel.at(free, theta, problem.states, problem)
        for _ in range(6):
            if not local.is_finite or problem.defect(local) < 1e-9:
                break
            local = local.after(np.zeros(len(local.theta)), problem)
        if not local.is_finite or problem.defect(local) > 1e-3:
            raise FitError(
                "law discovery: the learned force does not explain the "
                "trajectories; fit it to them first"
            )
        return eqx.tree_at(lambda p: p.states, problem, np.asarray(local.states)), local
