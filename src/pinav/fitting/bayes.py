"""`fit_bayes`: a kernel environment from noisy data, with everything it needs.

Lifted Gauss-Newton steps with the starts eliminated; at every step the evidence
chooses shape of the prior, amplitude and noise anew, so that nothing is set by hand.
"""

import enum
from collections.abc import Callable
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, PyTree

from pinav.dynamics import Swimmer, with_dtype
from pinav.errors import FitError, InputError
from pinav.fitting.evidence import (
    Data,
    FlatBlock,
    Hyperparameters,
    Quadratic,
    best_hyperparameters,
    is_singular,
    joint_posterior,
    shape_covariance,
    weight_posterior,
    without_flat,
)
from pinav.fitting.kernels import WeightPrior
from pinav.fitting.lifting import (
    FreeModel,
    Linearisation,
    advanced,
    freed,
    linearise,
)
from pinav.fitting.objectives import Observations
from pinav.fitting.posterior import Posterior
from pinav.fitting.smoother import smoothed_states
from pinav.learned import KernelForce, KernelPotential
from pinav.solvers import FixedStep
from pinav.trajectories import Trajectories

EVIDENCE_TOLERANCE, DEFECT_TOLERANCE = 1e-2, 1e-4
"""Converged: change of the log evidence, and defects relative to the states' spread."""

ROUNDING = 1e-9
"""Defects at which another step changes nothing but the last digits of the evidence."""


class BayesOutcome(enum.IntEnum):
    """How a Bayesian fit ended."""

    CONVERGED = 0
    STALLED = 1
    DIVERGED = 2


class Estimate(eqx.Module):
    """A learned constant.

    Attributes:
        value: its best value.
        sd: its standard deviation.
    """

    value: float
    sd: float


class BayesProgress(eqx.Module):
    """What a progress bar shows after each step.

    Attributes:
        done: steps done.
        total: steps at most.
        defect: by which the states miss the dynamics, relative to their spread.
        noise: standard deviation of the observations.
        log_evidence: of the hyperparameters chosen.
    """

    done: int
    total: int
    defect: float
    noise: float
    log_evidence: float


class BayesFit(eqx.Module):
    """A fitted kernel environment, and how well it is known.

    Attributes:
        model: the model with its best parameters.
        outcome: stalled when the iterations ran out, diverged when the defects grew
            or became infinite; the rest is then what was reached last.
        iterations: Gauss-Newton steps taken.
        hyperparameters: noise, shape of the prior (`WeightPrior`), amplitude, and the
            log evidence.
        posterior: distribution of all learned parameters.
        constants: learned constants by the path of their leaf, as `drag.damping`.
        states: the smoothed states; they fulfil the dynamics when converged.
    """

    model: Swimmer
    outcome: BayesOutcome = eqx.field(static=True)
    iterations: int = eqx.field(static=True)
    hyperparameters: Hyperparameters
    posterior: Posterior
    constants: dict[str, Estimate]
    states: Float[np.ndarray, "trajectory time state"]


def fit_bayes(
    model: Swimmer,
    trajectories: Trajectories,
    *,
    learn: Callable[[Swimmer], PyTree] = lambda _: (),
    noise: float | None = None,
    solver: FixedStep | None = None,
    max_iterations: int = 20,
    on_step: Callable[[BayesProgress], None] | None = None,
    throw: bool = True,
) -> BayesFit:
    r"""Fit the kernel environment of a swimmer, and constants, to noisy trajectories.

    The weights have a Gaussian-process prior, the constants and all starts a flat one.
    The rollout is a strong constraint: no process noise. The result needs neither
    velocities nor regular times. A constant force along the thrust is hard to tell
    from a wide slope of the environment: where the thrust is learned, its standard
    deviation says so.

    Args:
        model: its environment is a `KernelForce` or a `KernelPotential`, such as
            `kernel_environment` makes; its weights are where the fit starts.
        trajectories: what was observed; any entries may be missing.
        learn: picks a constant to learn too, such as `lambda m: m.drag.damping`, or
            a tuple of them.
        noise: standard deviation of the observations; estimated unless given.
        solver: steps between samples; `FixedStep()` unless given.
        max_iterations: after which the fit counts as stalled.
        on_step: called after each step.
        throw: raise where the fit did not converge.

    Raises:
        InputError: the model has no kernels, the trajectories are not its own, or are
            too few, or `noise` is not positive.
        FitError: the data do not determine the constants or a start, or the fit did
            not converge and `throw` is true.
    """
    _check(model, trajectories, noise, max_iterations)
    with jax.enable_x64(new_val=True):
        solver = FixedStep() if solver is None else solver
        problem = _Problem.of(model, trajectories, learn, noise, solver)
        result = problem.result(*_iterate(problem, max_iterations, on_step))
    if throw and result.outcome is not BayesOutcome.CONVERGED:
        raise FitError(_MESSAGES[result.outcome])
    return result


_MESSAGES = {
    BayesOutcome.STALLED: (
        "the fit stalled: its iterations ran out before the states fulfilled the "
        "dynamics; raise max_iterations, or pass throw=False to get what was reached"
    ),
    BayesOutcome.DIVERGED: (
        "the fit diverged: the states depart from the dynamics; check the known "
        "forces, add substeps, or pass throw=False to get what was reached"
    ),
}


class _Step(eqx.Module):
    """One Gauss-Newton step: what it started with, chose and reached."""

    defect: float
    hyperparameters: Hyperparameters
    data: Data
    block: FlatBlock
    mean: Float[np.ndarray, " parameter"]
    covariance: Float[np.ndarray, "parameter parameter"]
    states: Float[jax.Array, "trajectory time state"]


def _iterate(
    problem: "_Problem",
    max_iterations: int,
    on_step: Callable[[BayesProgress], None] | None = None,
) -> tuple[BayesOutcome, list[_Step]]:
    """Gauss-Newton steps until they converge, diverge or run out."""
    theta, states, shape = problem.theta, problem.states, problem.prior.start
    steps: list[_Step] = []
    while len(steps) < max_iterations:
        step = problem.step(theta, states, shape)
        if step is None:
            return BayesOutcome.DIVERGED, steps
        theta, states, shape = step.mean, step.states, step.hyperparameters.shape
        steps.append(step)
        if on_step:
            on_step(_progress(steps, max_iterations))
        outcome = _outcome(steps)
        if outcome is not BayesOutcome.STALLED:
            return outcome, steps
    return BayesOutcome.STALLED, steps


def _progress(steps: list[_Step], total: int) -> BayesProgress:
    chosen, defect = steps[-1].hyperparameters, steps[-1].defect
    return BayesProgress(len(steps), total, defect, chosen.noise, chosen.log_evidence)


def _outcome(steps: list[_Step]) -> BayesOutcome:
    """Converged, or not yet; defects that grow without bound count as diverged."""
    last = steps[-1]
    if len(steps) > 1:
        before = steps[-2].hyperparameters.log_evidence
        change = abs(last.hyperparameters.log_evidence - before)
        if change < EVIDENCE_TOLERANCE and last.defect < DEFECT_TOLERANCE:
            return BayesOutcome.CONVERGED
    if last.defect < ROUNDING:
        return BayesOutcome.CONVERGED
    if last.defect > 100 * max(steps[0].defect, 1.0):
        return BayesOutcome.DIVERGED
    return BayesOutcome.STALLED


class _Problem(eqx.Module):
    """The start of a fit, and its parts that do not change while it runs."""

    free: FreeModel
    theta: Float[np.ndarray, " parameter"]
    states: Float[jax.Array, "trajectory time state"]
    num_free: int
    prior: WeightPrior
    names: tuple[str, ...]
    flat: Bool[np.ndarray, " parameter"]
    observations: Observations
    scale: Float[np.ndarray, " state"]
    noise: float | None
    solver: FixedStep

    @classmethod
    def of(cls, model, trajectories, learn, noise, solver):
        free, theta = freed(with_dtype(model, jnp.float64), _trainable(learn))
        names = _names(free, theta)
        is_weight = [name.startswith("environment.weights") for name in names]
        for name, weight in zip(names, is_weight, strict=True):
            if name.startswith("environment.") and not weight:
                raise InputError(
                    f"fit_bayes learn: {name} belongs to the environment, whose "
                    "weights alone are learned; pick constants of other forces"
                )
        states = smoothed_states(trajectories)
        num_free = trajectories.num_observed - states[:, 0].size
        if num_free <= len(names) - sum(is_weight):
            raise InputError(
                f"fit_bayes trajectories: {trajectories.num_observed} observations "
                "are no more than the starts and constants to be found; add samples"
            )
        return cls(
            free=free,
            theta=np.asarray(theta),
            states=jnp.asarray(states),
            num_free=num_free,
            prior=WeightPrior(cast(Any, model.environment)),
            names=names,
            flat=~np.array(is_weight),
            observations=Observations.of(trajectories, jnp.float64),
            scale=_spread(states, trajectories.lengths),
            noise=noise,
            solver=solver,
        )

    def step(self, theta, states, shape) -> _Step | None:
        """One step, or None where the linearisation is not finite."""
        linear = linearise(
            self.free, jnp.asarray(theta), states, self.observations, self.solver
        )
        if not np.all(np.isfinite(linear.start_information)):
            return None
        _check_starts(linear)
        if not np.all(np.isfinite(linear.hessian)):
            return None
        quadratic, block = without_flat(self.quadratic(theta, linear), self.flat)
        data, covariance = Data.of(quadratic), self.prior.covariance
        chosen = best_hyperparameters(
            data, covariance, shape, self.prior.bounds, self.noise
        )
        weights = weight_posterior(data, covariance(chosen.shape), chosen)
        mean, spread = joint_posterior(block, *weights, chosen.noise)
        change = jnp.asarray(mean - theta)
        return _Step(
            defect=float(np.max(np.asarray(linear.defects) / self.scale)),
            hyperparameters=chosen,
            data=data,
            block=block,
            mean=mean,
            covariance=spread,
            states=advanced(states, linear, change),
        )

    def quadratic(self, theta, linear: Linearisation) -> Quadratic:
        starts = np.asarray(linear.start_information)
        return Quadratic(
            theta,
            np.asarray(linear.hessian),
            np.asarray(linear.gradient),
            float(linear.squares),
            num_free=self.num_free,
            log_determinant=float(np.linalg.slogdet(starts).logabsdet.sum()),
        )

    def with_shape_uncertainty(self, step: _Step) -> Posterior:
        """The posterior after a step, that of the prior's shape included."""
        extra = shape_covariance(
            step.data, self.prior.covariance, step.hyperparameters, self.noise
        )
        return Posterior(self.free, step.mean, step.covariance + step.block.lift(extra))

    def result(self, outcome: BayesOutcome, steps: list[_Step]) -> BayesFit:
        if not steps:
            raise FitError(
                "the fit diverged at once: the model's rates of change are not finite "
                "at the observed states; check its constants"
            )
        last = steps[-1]
        posterior = self.with_shape_uncertainty(last)
        sd = np.sqrt(np.diag(posterior.covariance))
        constants = {
            self.names[i]: Estimate(float(last.mean[i]), float(sd[i]))
            for i in np.flatnonzero(self.flat)
        }
        return BayesFit(
            model=posterior.model,
            outcome=outcome,
            iterations=len(steps),
            hyperparameters=last.hyperparameters,
            posterior=posterior,
            constants=constants,
            states=np.asarray(last.states),
        )


def _trainable(learn):
    def select(model):
        constants = learn(model)
        several = constants if isinstance(constants, tuple | list) else (constants,)
        return model.environment.weights, *several

    return select


def _names(free: FreeModel, theta) -> tuple[str, ...]:
    """A name for every entry of the parameter vector: the path of its leaf."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(free.unravel(theta))
    names = []
    for path, leaf in leaves:
        name = jax.tree_util.keystr(path).lstrip(".")
        indices = np.ndindex(*leaf.shape) if leaf.ndim else [None]
        names += [name if i is None else f"{name}{list(i)}" for i in indices]
    return tuple(names)


def _spread(states, lengths):
    """Standard deviation of each channel over all samples; 1 where it is constant."""
    samples = np.concatenate(
        [own[:length] for own, length in zip(states, lengths, strict=True)]
    )
    spread = samples.std(axis=0)
    return np.where(spread > 0, spread, 1.0)


def _check_starts(linear: Linearisation) -> None:
    for index, matrix in enumerate(np.asarray(linear.start_information)):
        if is_singular(matrix):
            raise FitError(
                f"the fit is singular: the observations of trajectory {index} do not "
                "determine its start; drop the trajectory"
            )


def _check(model, trajectories, noise, max_iterations):
    environment = getattr(model, "environment", None)
    if not isinstance(environment, KernelForce | KernelPotential):
        raise InputError(
            "fit_bayes model.environment: expected KernelForce or KernelPotential, "
            f"got {type(environment).__name__}; make one by kernel_environment"
        )
    states = 2 * environment.centers.shape[1]
    if states != len(trajectories.channels):
        raise InputError(
            f"fit_bayes trajectories: expected {states} channels, positions and "
            f"velocities, got {', '.join(trajectories.channels)}"
        )
    if noise is not None and not 0 < noise < np.inf:
        raise InputError(
            f"fit_bayes noise: expected a finite number > 0, got {noise}; leave it "
            "out to estimate it"
        )
    if max_iterations < 1:
        raise InputError(
            f"fit_bayes max_iterations: expected >= 1, got {max_iterations}"
        )
