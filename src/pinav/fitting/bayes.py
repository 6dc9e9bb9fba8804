"""`fit_bayes`: an environment from noisy data, with everything it needs.

Lifted Gauss-Newton steps with the starts eliminated; at every step the evidence
chooses shape of the prior, amplitude and noise anew, so that nothing is set by hand.
"""

import enum
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, PyTree

from pinav.dynamics import AbstractDynamics
from pinav.errors import FitError, InputError
from pinav.fitting.bayes_problem import BayesProblem, Step, num_positions
from pinav.fitting.descent import Move
from pinav.fitting.distil import distilled, lesson
from pinav.fitting.evidence import Hyperparameters
from pinav.fitting.kernels import kernel_environment
from pinav.fitting.occam import LinearFit
from pinav.fitting.posterior import Posterior
from pinav.forces import AbstractForce
from pinav.learned import (
    KernelForce,
    KernelPotential,
    NeuralForce,
    NeuralPotential,
)
from pinav.solvers import FixedStep
from pinav.trajectories import Trajectories

DEFECT_TOLERANCE = 1e-4
"""Converged: defects relative to the states' spread."""

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
    """A fitted environment, and how well it is known.

    Attributes:
        model: the model with its best parameters.
        outcome: stalled when the iterations ran out, diverged when the defects grew
            or became infinite; the rest is then what was reached last.
        iterations: Gauss-Newton steps taken.
        hyperparameters: noise, shape of the prior (`WeightPrior`; empty for networks
            and parametric forces), amplitude (0 without weights), and the log evidence.
        posterior: distribution of all learned parameters.
        constants: learned constants by the path of their leaf, as `drag.damping`.
        states: the smoothed states; they fulfil the dynamics when converged.
        linear: the linear problem in which it ended; see `model_evidence`.
    """

    model: Any
    outcome: BayesOutcome = eqx.field(static=True)
    iterations: int = eqx.field(static=True)
    hyperparameters: Hyperparameters
    posterior: Posterior
    constants: dict[str, Estimate]
    states: Float[np.ndarray, "trajectory time state"]
    linear: LinearFit


def fit_bayes(
    model: AbstractDynamics,
    trajectories: Trajectories,
    *,
    learn: Callable[[Any], PyTree] = lambda _: (),
    noise: float | None = None,
    solver: FixedStep | None = None,
    max_iterations: int = 20,
    on_step: Callable[[BayesProgress], None] | None = None,
    throw: bool = True,
) -> BayesFit:
    r"""Fit the environment of a swimmer, and constants, to noisy trajectories.

    The weights of a kernel environment have a Gaussian-process prior, those of a
    network independent ones of one variance; constants, parametric environments and
    all starts have a flat one. A network is taught by a kernel fit first; its bands
    are too wide (docs/fitting.md). The rollout is a strong constraint: no process
    noise. The result needs neither velocities nor regular times. A constant force
    along the thrust is hard to tell from a wide slope of the environment: where the
    thrust is learned, its standard deviation says so.

    Args:
        model: dynamics with a field `environment`, of second order (`Swimmer`) or,
            where the state is the position, of first. With kernels or a network,
            such as `kernel_environment` and `neural_environment` make, all weights
            are learned; with any other force what `learn` picks of it. The fit starts
            from the model's values.
        trajectories: what was observed; any entries may be missing.
        learn: picks a constant to learn too, such as `lambda m: m.drag.damping`, or
            a tuple of them; `lambda m: m.environment` picks all numbers of a
            parametric force.
        noise: standard deviation of the observations; estimated unless given.
        solver: steps between samples; `FixedStep()` unless given.
        max_iterations: after which the fit counts as stalled.
        on_step: called after each step.
        throw: raise where the fit did not converge.

    Raises:
        InputError: there is nothing to learn, the trajectories are not its own, or are
            too few, or `noise` is not positive.
        FitError: the data do not determine the constants or a start, or the fit did
            not converge and `throw` is true.
    """
    _check(model, noise, max_iterations)
    with jax.enable_x64(new_val=True):
        solver = FixedStep() if solver is None else solver
        problem = _begun(model, trajectories, learn, noise, solver)
        result = _result(problem, *iterate(problem, max_iterations, on_step))
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


KERNELS = {NeuralForce: KernelForce, NeuralPotential: KernelPotential}
"""The kernels that teach a network of each kind."""


def _begun(model, trajectories, learn, noise, solver) -> BayesProblem:
    """The fit at its start: from the model's values, or taught by a kernel fit."""
    given = BayesProblem.of(model, trajectories, learn, noise, solver)
    environment = model.environment
    if not isinstance(environment, NeuralForce | NeuralPotential):
        return given
    dim = num_positions(model, trajectories)
    kernels = kernel_environment(KERNELS[type(environment)], trajectories, dim=dim)
    replaced = eqx.tree_at(lambda m: m.environment, model, kernels)
    teaching = BayesProblem.of(replaced, trajectories, learn, noise, solver)
    outcome, steps = iterate(teaching, TEACHING_STEPS)
    if outcome is BayesOutcome.DIVERGED:
        return given
    teacher = _result(teaching, outcome, steps)
    taught = lesson(
        teacher.model.environment,
        trajectories,
        teacher.states,
        dim=dim,
        margin=float(kernels.width),
    )
    start = eqx.tree_at(
        lambda m: m.environment, teacher.model, distilled(environment, taught)
    )
    return BayesProblem.of(
        start, trajectories, learn, noise, solver, states=teacher.states
    )


TEACHING_STEPS = 20
"""Of the kernel fit at most."""


def iterate(
    problem: Any,
    max_iterations: int,
    on_step: Callable[[BayesProgress], None] | None = None,
) -> tuple[BayesOutcome, list[Step]]:
    """Steps until they converge, diverge or run out.

    Args:
        problem: a `BayesProblem`, or what steps as it does.
        max_iterations: steps at most.
        on_step: called after each step.
    """
    move = Move(problem.theta, problem.states, problem.descent)
    shape = problem.weights.start
    steps: list[Step] = []
    while len(steps) < max_iterations:
        step = _attempt(problem, move, shape, begun=bool(steps))
        if step is None:
            return BayesOutcome.DIVERGED, steps
        move, shape = step.move, step.inference.hyperparameters.shape
        steps.append(step)
        if on_step:
            on_step(_progress(steps, max_iterations))
        outcome = _outcome(steps, problem.tolerance)
        if outcome is not BayesOutcome.STALLED:
            return outcome, steps
    return BayesOutcome.STALLED, steps


def _attempt(problem, move, shape, *, begun: bool) -> Step | None:
    """One step; None where it leads nowhere, after others that did."""
    try:
        return problem.step(move, shape)
    except FitError:
        if begun:
            return None
        raise


def _progress(steps: list[Step], total: int) -> BayesProgress:
    chosen, defect = steps[-1].inference.hyperparameters, steps[-1].defect
    return BayesProgress(len(steps), total, defect, chosen.noise, chosen.log_evidence)


def _outcome(steps: list[Step], tolerance: float) -> BayesOutcome:
    """Converged, or not yet; defects that grow without bound count as diverged."""
    last = steps[-1]
    if len(steps) > 1:
        before = steps[-2].inference.hyperparameters.log_evidence
        change = abs(last.inference.hyperparameters.log_evidence - before)
        if change < tolerance and last.defect < DEFECT_TOLERANCE:
            return BayesOutcome.CONVERGED
    if last.defect < ROUNDING:
        return BayesOutcome.CONVERGED
    if last.defect > 100 * max(steps[0].defect, 1.0):
        return BayesOutcome.DIVERGED
    return BayesOutcome.STALLED


def _result(
    problem: BayesProblem, outcome: BayesOutcome, steps: list[Step]
) -> BayesFit:
    if not steps:
        raise FitError(
            "the fit diverged at once: the model's rates of change are not finite "
            "at the observed states; check its constants"
        )
    last = steps[-1]
    posterior = problem.with_shape_uncertainty(last)
    sd = np.sqrt(np.diag(posterior.covariance))
    constants = {
        problem.names[i]: Estimate(float(posterior.mean[i]), float(sd[i]))
        for i in np.flatnonzero(problem.flat)
    }
    return BayesFit(
        model=posterior.model,
        outcome=outcome,
        iterations=len(steps),
        hyperparameters=last.inference.hyperparameters,
        posterior=posterior,
        constants=constants,
        states=np.asarray(last.move.states),
        linear=problem.linear_fit(last),
    )


def _check(model, noise, max_iterations):
    if not isinstance(getattr(model, "environment", None), AbstractForce):
        raise InputError(
            "fit_bayes model: expected dynamics with a force called environment, got "
            f"{type(model).__name__}"
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
