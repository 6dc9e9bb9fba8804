r"""Laws refitted through the equations of motion, on the trajectories themselves.

Residuals of observations are independent, those of a learned field are not: here the
likelihood, and so the comparison of laws and their intervals, is exact.
"""

import enum
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.analysis.laws import AbstractLaw, LawForce, Role
from pinav.dynamics import Swimmer, with_dtype
from pinav.fitting import Observations
from pinav.fitting.lifting import FreeModel, advanced, freed, linearise
from pinav.solvers import FixedStep
from pinav.trajectories import Trajectories

MAX_ITERATIONS = 40
SINGULAR = 1e-12
"""Relative eigenvalue of the scaled normal matrix that counts as zero."""

ROUNDING = 1e-10
"""Root-mean-square residual, relative to the states, below which all fits are equal."""


class RefitOutcome(enum.Enum):
    """How a refit ended."""

    CONVERGED = "converged"
    STALLED = "stalled"
    DIVERGED = "diverged"


class Refit(eqx.Module):
    r"""A law refitted on trajectories.

    Attributes:
        law: the formula.
        constants: its best constants.
        covariance: their covariance; infinite in directions the data say nothing of.
        squares: sum of squared residuals.
        noise: $\sigma$ of the observations, estimated.
        num_residuals: observations less starts.
        outcome: what was reached when the refit stalled or diverged is not a best fit.
    """

    law: AbstractLaw = eqx.field(static=True)
    constants: Float[np.ndarray, " constant"]
    covariance: Float[np.ndarray, "constant constant"]
    squares: float
    noise: float
    num_residuals: int
    outcome: RefitOutcome = eqx.field(static=True)

    @property
    def bic(self) -> float:
        r"""$n \log(\sum r^2/n) + k \log n$; infinite where the refit diverged."""
        if self.outcome is RefitOutcome.DIVERGED or not self.squares > 0:
            return np.inf
        count = self.num_residuals
        mean = self.squares / count
        return float(count * np.log(mean) + len(self.constants) * np.log(count))


class Lifted(eqx.Module):
    """A model, its free constants, and where it is linearised.

    Attributes:
        free: the model as a function of its constants.
        theta: their values.
        states: one for each sample.
        linear: the linearisation about them.
    """

    free: FreeModel
    theta: Float[np.ndarray, " parameter"]
    states: Any
    linear: Any

    @classmethod
    def at(cls, free, theta, states, problem: "RefitProblem") -> "Lifted":
        """Linearise about constants and states."""
        linear = linearise(
            free, jnp.asarray(theta), states, problem.observations, problem.solver
        )
        return cls(free, np.asarray(theta), states, linear)

    def moved(self, change, problem: "RefitProblem") -> "Lifted":
        """After a change of the constants, each start at its best."""
        states = advanced(self.states, self.linear, jnp.asarray(change))
        return Lifted.at(self.free, self.theta + change, states, problem)

    @property
    def squares(self) -> float:
        """Sum of squares, once the defects are closed."""
        return float(self.linear.squares)

    @property
    def is_finite(self) -> bool:
        """Whether the linearisation can be used."""
        parts = (self.linear.hessian, self.linear.gradient, self.linear.squares)
        return all(bool(np.all(np.isfinite(part))) for part in parts)


class RefitProblem(eqx.Module):
    """What all refits on the same trajectories share.

    Attributes:
        observations: the trajectories.
        states: where the first linearisation stands.
        scale: spread of each channel.
        extent: of the positions [L].
        num_residuals: observations less starts.
        solver: steps between samples.
    """

    observations: Observations
    states: Any
    scale: Float[np.ndarray, " state"]
    extent: float
    num_residuals: int
    solver: FixedStep

    @classmethod
    def of(
        cls,
        trajectories: Trajectories,
        states: Float[np.ndarray, "trajectory time state"],
        solver: FixedStep,
    ) -> "RefitProblem":
        """The problem of `trajectories`, linearised first about `states`."""
        spread = states.reshape(-1, states.shape[-1]).std(axis=0)
        positions = states[..., :2].reshape(-1, 2)
        return cls(
            Observations.of(trajectories, jnp.float64),
            jnp.asarray(states),
            np.where(spread > 0, spread, 1.0),
            float(np.ptp(positions, axis=0).max()),
            trajectories.num_observed - states[:, 0].size,
            solver,
        )

    def defect(self, lifted: Lifted) -> float:
        """The largest defect, relative to the spread of its channel."""
        return float(np.max(np.asarray(lifted.linear.defects) / self.scale))

    def closed(self, lifted: Lifted, iterations: int = 6) -> Lifted:
        """States that fulfil the dynamics, for the same constants."""
        for _ in range(iterations):
            if not lifted.is_finite or self.defect(lifted) < 1e-9:
                break
            lifted = lifted.moved(np.zeros(len(lifted.theta)), self)
        return lifted


def refit(
    law: AbstractLaw,
    constants: Float[np.ndarray, " constant"],
    model: Swimmer,
    problem: RefitProblem,
) -> Refit:
    """Least squares of a law through the dynamics, by damped lifted Gauss-Newton.

    Args:
        law: the formula.
        constants: where to start.
        model: its propulsion and drag are kept.
        problem: the trajectories.
    """
    with jax.enable_x64(new_val=True):
        environment = LawForce(law, jnp.asarray(constants, jnp.float64))
        swimmer = eqx.tree_at(lambda m: m.environment, model, environment)
        free, theta = freed(
            with_dtype(swimmer, jnp.float64), lambda m: m.environment.constants
        )
        lifted = Lifted.at(free, theta, problem.states, problem)
        return _result(law, *_minimised(law, lifted, problem), problem)


def _minimised(law, lifted, problem):
    """Levenberg-Marquardt steps; a refused one still closes the defects."""
    damping = 1e-3
    if not lifted.is_finite:
        return lifted, RefitOutcome.DIVERGED
    for _ in range(MAX_ITERATIONS):
        change, gain = _step(law, lifted, damping, problem.extent)
        noise = lifted.squares / problem.num_residuals
        small = np.all(np.abs(change) < 1e-10 * (1e-3 + np.abs(lifted.theta)))
        settled = gain < 1e-4 * noise or small
        if settled and problem.defect(lifted) < 1e-6:
            return lifted, RefitOutcome.CONVERGED
        trial = lifted.moved(change, problem)
        if trial.is_finite and trial.squares <= lifted.squares * (1 + 1e-12):
            lifted, damping = trial, max(damping / 10, 1e-12)
            continue
        closed = lifted.moved(np.zeros(len(change)), problem)
        if not closed.is_finite or damping > 1e8:
            return lifted, RefitOutcome.DIVERGED
        lifted, damping = closed, damping * 10
    return lifted, RefitOutcome.STALLED


def _step(law, lifted, damping, extent):
    """A damped step within reason, and the decrease of the squares it promises."""
    hessian = np.asarray(lifted.linear.hessian)
    gradient = np.asarray(lifted.linear.gradient)
    root = np.sqrt(np.maximum(np.diag(hessian), np.finfo(float).tiny))
    scaled = hessian / np.outer(root, root) + damping * np.eye(len(root))
    change = -np.linalg.lstsq(scaled, gradient / root, rcond=1e-13)[0] / root
    largest = np.max(np.abs(change) / _reach(law, lifted.theta, extent))
    change = change / max(largest, 1.0)
    return change, -float(2 * gradient @ change + change @ hessian @ change)


def _reach(law, theta, extent):
    """How far one step may go in each constant."""
    size = np.abs(theta)
    by_role = {
        Role.AMPLITUDE: size + 0.5 * size.max(),
        Role.POSITION: np.full(len(theta), 0.3 * extent),
        Role.SCALE: 0.5 * size,
        Role.ANGLE: np.full(len(theta), 0.3),
    }
    return np.array([by_role[c.role][i] for i, c in enumerate(law.constants)])


def _result(law, lifted, outcome, problem):
    count = problem.num_residuals
    free = max(count - len(lifted.theta), 1)
    least = count * (ROUNDING * float(problem.scale.max())) ** 2
    squares = max(lifted.squares, least)
    variance = squares / free
    return Refit(
        law=law,
        constants=lifted.theta,
        covariance=variance * _inverse(np.asarray(lifted.linear.hessian)),
        squares=squares,
        noise=float(np.sqrt(variance)),
        num_residuals=count,
        outcome=outcome,
    )


def _inverse(hessian):
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
