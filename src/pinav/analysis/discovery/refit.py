r"""Laws refitted through the equations of motion, on the trajectories themselves.

Residuals of observations are independent, those of a learned field are not: here the
likelihood, and so the comparison of laws and their intervals, is exact.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.analysis.discovery.laws import AbstractLaw, LawForce, Role
from pinav.dynamics import FixedStep, Swimmer, with_dtype
from pinav.fitting import Outcome
from pinav.fitting.engine.parametric_model import ParametricModel, ravel_model
from pinav.trajectories import Trajectories

MAX_ITERATIONS = 40
FEW = 16
"""Constants up to which forward derivatives are cheaper than reverse ones."""

SINGULAR = 1e-12
"""Relative eigenvalue of the scaled normal matrix that counts as zero."""

ROUNDING = 1e-10
"""Root-mean-square residual, relative to the states, below which all fits are equal."""


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
    outcome: Outcome = eqx.field(static=True)

    @property
    def bic(self) -> float:
        r"""$n \log(\sum r^2/n) + k \log n$; infinite where the refit diverged."""
        if self.outcome is Outcome.DIVERGED or not self.squares > 0:
            return np.inf
        count = self.num_residuals
        mean = self.squares / count
        return float(count * np.log(mean) + len(self.constants) * np.log(count))


class Lifted(eqx.Module):
    r"""A model linearised about states that need not solve it, the starts eliminated.

    The same least squares as `pinav.fitting.engine.multiple_shooting`, for many small
    models in turn: only the steps are compiled for each of them.

    Attributes:
        free: the model as a function of its free constants.
        theta: their values.
        states: one for each sample.
        columns: change of the states with the constants, with the start, and that
            which closes the defects.
        start_rows: the change of the starts is minus these rows times (change, 1).
        hessian: $H$ of the sum of squares $q + 2 g\cdot\delta + \delta\cdot H\delta$.
        gradient: $g$.
        squares: $q$.
        defects: largest defect of each channel.
    """

    free: ParametricModel
    theta: Float[np.ndarray, " parameter"]
    states: Float[np.ndarray, "trajectory time state"]
    columns: Float[np.ndarray, "trajectory time state column"]
    start_rows: Float[np.ndarray, "trajectory state row"]
    hessian: Float[np.ndarray, "parameter parameter"]
    gradient: Float[np.ndarray, " parameter"]
    squares: float
    defects: Float[np.ndarray, " state"]

    @classmethod
    def at(cls, free, theta, states, problem: "RefitProblem") -> "Lifted":
        """Linearise about constants and states."""
        times, solver = problem.trajectories.times, problem.solver
        inputs = (jnp.asarray(theta), jnp.asarray(states), jnp.asarray(times), solver)
        by_state, by_constant, ends = map(np.asarray, _steps(free, *inputs))
        defects = ends - states[:, 1:]
        columns = _recursion(by_state, by_constant, defects)
        reduced, start_rows = _eliminated(columns, states, problem.trajectories)
        return cls(
            free=free,
            theta=np.asarray(theta),
            states=states,
            columns=columns,
            start_rows=start_rows,
            hessian=reduced[:-1, :-1],
            gradient=reduced[:-1, -1],
            squares=float(reduced[-1, -1]),
            defects=np.abs(defects).max(axis=(0, 1)),
        )

    def moved(self, change, problem: "RefitProblem") -> "Lifted":
        """After a change of the constants, each start at its best."""
        starts = -self.start_rows @ np.append(change, 1.0)
        count = len(starts)
        shared = np.broadcast_to(change, (count, len(change)))
        step = np.concatenate([shared, starts, np.ones((count, 1))], axis=1)
        states = self.states + np.einsum("itsc,ic->its", self.columns, step)
        return Lifted.at(self.free, self.theta + change, states, problem)

    @property
    def is_finite(self) -> bool:
        """Whether the linearisation can be used."""
        parts = (self.hessian, self.gradient, self.squares, self.states)
        return all(bool(np.all(np.isfinite(part))) for part in parts)


@eqx.filter_jit
def _steps(free, theta, states, times, solver):
    """Every step from one sample to the next, and its derivatives."""
    derivative = jax.jacfwd if theta.shape[0] <= FEW else jax.jacrev

    def step(theta, y, t0, t1):
        return solver.looped_step(free(theta), y, t0, t1)

    def one(y, t0, t1):
        by_constant = derivative(step)(theta, y, t0, t1)
        by_state = jax.jacfwd(step, argnums=1)(theta, y, t0, t1)
        return by_state, by_constant, step(theta, y, t0, t1)

    return jax.vmap(jax.vmap(one))(states[:, :-1], times[:, :-1], times[:, 1:])


def _recursion(by_state, by_constant, defects):
    """Accumulate the derivatives of the steps along each trajectory."""
    count, steps, size, constants = by_constant.shape
    columns = np.zeros((count, steps + 1, size, constants + size + 1))
    columns[:, 0, :, constants:-1] = np.eye(size)
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(steps):
            columns[:, k + 1] = by_state[:, k] @ columns[:, k]
            columns[:, k + 1, :, :constants] += by_constant[:, k]
            columns[:, k + 1, :, -1] += defects[:, k]
    return columns


def _eliminated(columns, states, trajectories):
    """Normal equations over all trajectories, each minimised over its own start.

    By a QR decomposition: the start of a sensitive trajectory has columns too large
    for its normal equations.
    """
    count, _, size, width = columns.shape
    rows = columns.copy()
    rows[..., -1] += states - trajectories.states
    rows = np.where(trajectories.observed[..., None], rows, 0.0)
    rows = np.roll(rows.reshape(count, -1, width), size + 1, axis=2)
    rows = np.concatenate([rows[..., :size], np.roll(rows[..., size:], -1, 2)], axis=2)
    if not np.all(np.isfinite(rows)):
        unknown = np.full((width - size,) * 2, np.nan)
        return unknown, np.full((count, size, width - size), np.nan)
    rows = np.pad(rows, [(0, 0), (0, max(0, width - rows.shape[1])), (0, 0)])
    triangles = np.asarray(np.linalg.qr(rows, mode="r"))
    rest = triangles[:, size:, size:]
    inverse = np.linalg.pinv(triangles[:, :size, :size], rcond=1e-14)
    start_rows = inverse @ triangles[:, :size, size:]
    return (np.swapaxes(rest, 1, 2) @ rest).sum(axis=0), start_rows


class RefitProblem(eqx.Module):
    """What all refits on the same trajectories share.

    Attributes:
        trajectories: what was observed.
        states: where the first linearisation stands.
        scale: spread of each channel.
        extent: of the positions [L].
        num_residuals: observations less starts.
        solver: steps between samples.
    """

    trajectories: Trajectories
    states: Float[np.ndarray, "trajectory time state"]
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
            trajectories,
            states,
            np.where(spread > 0, spread, 1.0),
            float(np.ptp(positions, axis=0).max()),
            trajectories.num_observed - states[:, 0].size,
            solver,
        )

    def defect(self, lifted: Lifted) -> float:
        """The largest defect, relative to the spread of its channel."""
        return float(np.max(lifted.defects / self.scale))

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
        swimmer = model.with_environment(environment)
        free, theta = ravel_model(
            with_dtype(swimmer, jnp.float64), lambda m: m.environment.constants
        )
        lifted = Lifted.at(free, theta, problem.states, problem)
        return _result(law, *_minimised(law, lifted, problem), problem)


def _minimised(law, lifted, problem):
    """Levenberg-Marquardt steps; a refused one still closes the defects."""
    damping = 1e-3
    if not lifted.is_finite:
        return lifted, Outcome.DIVERGED
    for _ in range(MAX_ITERATIONS):
        change, gain = _step(law, lifted, damping, problem.extent)
        variance = lifted.squares / problem.num_residuals
        small = np.all(np.abs(change) < 1e-10 * (1e-3 + np.abs(lifted.theta)))
        settled = gain < 1e-3 * variance or small
        if settled and problem.defect(lifted) < 1e-6:
            return lifted, Outcome.CONVERGED
        trial = lifted.moved(change, problem)
        if trial.is_finite and trial.squares <= lifted.squares * (1 + 1e-12):
            lifted, damping = trial, max(damping / 10, 1e-12)
            continue
        closed = lifted.moved(np.zeros(len(change)), problem)
        if not closed.is_finite or damping > 1e8:
            return lifted, Outcome.DIVERGED
        lifted, damping = closed, damping * 10
    return lifted, Outcome.STALLED


def _step(law, lifted, damping, extent):
    """A damped step within reason, and the decrease of the squares it promises."""
    hessian = lifted.hessian
    gradient = lifted.gradient
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
        covariance=variance * _inverse(lifted.hessian),
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
