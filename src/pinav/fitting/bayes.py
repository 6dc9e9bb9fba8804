"""`fit_bayes`: an environment from noisy data, with everything it needs.

Lifted Gauss-Newton steps with the starts eliminated; at every step the evidence
chooses shape of the prior, amplitude and noise anew, so that nothing is set by hand.
"""

import enum
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PyTree

from pinav.dynamics import AbstractDynamics
from pinav.errors import FitError, InputError
from pinav.fitting.bayes_problem import BayesProblem, Step
from pinav.fitting.descent import Move
from pinav.fitting.evidence import Hyperparameters
from pinav.fitting.occam import LinearFit
from pinav.fitting.posterior import Posterior
from pinav.fitting.refinement import AS_FINE_AS_ASKED, Refinement
from pinav.fitting.teaching import NEURAL, Request
from pinav.forces import AbstractForce
from pinav.solvers import FixedStep
from pinav.trajectories import Trajectories

DEFECT_TOLERANCE = 1e-4
"""Converged: defects relative to the states' spread."""

ROUNDING = 1e-9
"""Defects at which another step changes nothing but the last digits of the evidence."""


class BayesOutcome(enum.IntEnum):
    """How a Bayesian fit ended; coarse: converged, but finer kernels had no room."""

    CONVERGED = 0
    STALLED = 1
    DIVERGED = 2
    COARSE = 3


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
        done: steps done, on the kernels as they are now.
        total: steps at most.
        unknowns: number of weights and constants.
        defect: by which the states miss the dynamics, relative to their spread.
        noise: standard deviation of the observations.
        log_evidence: of the hyperparameters chosen.
    """

    done: int
    total: int
    unknowns: int
    defect: float
    noise: float
    log_evidence: float


class BayesFit(eqx.Module):
    """A fitted environment, and how well it is known.

    Attributes:
        model: the model with its best parameters.
        outcome: stalled when the iterations ran out, diverged when the defects grew
            or became infinite; the rest is then what was reached last. Coarse where
            the kernels blur what the data show, and finer ones would be too many.
        iterations: Gauss-Newton steps taken, on the last kernels.
        hyperparameters: noise, shape of the prior (`WeightPrior`; empty for parametric
            forces and for networks that see the time), amplitude (0 without weights),
            and the log evidence.
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
    refine: Refinement | None = AS_FINE_AS_ASKED,
    max_iterations: int = 20,
    on_step: Callable[[BayesProgress], None] | None = None,
    throw: bool = True,
) -> BayesFit:
    r"""Fit the environment of a swimmer, and constants, to noisy trajectories.

    The weights of a kernel environment have a Gaussian-process prior. A network is
    taught by a kernel fit first, whose process is then the prior of its forces; a
    network that sees the time has independent weights of one variance instead, and
    bands that are too wide (docs/fitting.md). Constants, parametric environments and
    all starts have a flat prior. The rollout is a strong constraint: no process
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
        refine: when kernels turn out too coarse, and the fit begins anew on finer
            ones; None keeps them.
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
        request = Request(model, trajectories, learn, noise, solver)
        grids = _Grids(request.problem, refine, trajectories)
        result = _result(*_refined(_begun(request), grids, max_iterations, on_step))
    if throw and result.outcome in _MESSAGES:
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


def _begun(request: Request) -> BayesProblem:
    """The fit at its start: from the model's values, or taught by a kernel fit."""
    given = request.problem(request.model)
    if not isinstance(request.model.environment, NEURAL):
        return given
    teaching = request.by_kernels()
    outcome, steps = iterate(teaching, TEACHING_STEPS)
    if outcome is BayesOutcome.DIVERGED:
        return given
    return request.taught(teaching, steps[-1])


TEACHING_STEPS = 20
"""Of the kernel fit at most."""


class _Grids(eqx.Module):
    """How a fit goes on where its kernels are too coarse."""

    begin: Callable[[Any], BayesProblem]
    refine: Refinement | None
    trajectories: Trajectories

    def wanted(self, problem: BayesProblem, step: Step) -> bool:
        shape = step.inference.hyperparameters.shape
        environment = problem.free.static.environment
        return self.refine is not None and self.refine.wanted(environment, shape)

    def finer(self, problem: BayesProblem, step: Step) -> BayesProblem | None:
        """The fit on finer kernels; None where they are not wanted, or too many."""
        if self.refine is None or not self.wanted(problem, step):
            return None
        model = problem.free(jnp.asarray(problem.theta))
        environment = self.refine.finer(model.environment, self.trajectories)
        if environment is None:
            return None
        return self.begin(eqx.tree_at(lambda m: m.environment, model, environment))


def _refined(
    problem: BayesProblem,
    grids: _Grids,
    max_iterations: int,
    on_step: Callable[[BayesProgress], None] | None,
) -> tuple[BayesProblem, BayesOutcome, list[Step]]:
    """Steps on kernels as fine as the evidence asks for.

    Each grid begins anew, so that the result is that of its own fit.
    """
    finer = partial(grids.finer, problem)
    outcome, steps = iterate(problem, max_iterations, on_step, finer)
    better = finer(steps[-1]) if steps else None
    if better is not None:
        return _refined(better, grids, max_iterations, on_step)
    if outcome is BayesOutcome.CONVERGED and grids.wanted(problem, steps[-1]):
        outcome = BayesOutcome.COARSE
    return problem, outcome, steps


PROBES = 2
"""Steps after which the evidence is asked whether the kernels are too coarse."""


def iterate(
    problem: Any,
    max_iterations: int,
    on_step: Callable[[BayesProgress], None] | None = None,
    finer: Callable[[Step], BayesProblem | None] = lambda _: None,
) -> tuple[BayesOutcome, list[Step]]:
    """Steps until they converge, diverge, run out, or had better be others.

    Args:
        problem: a `BayesProblem`, or what steps as it does.
        max_iterations: steps at most.
        on_step: called after each step.
        finer: a better problem to go on with after a step, if there is one.
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
        if len(steps) >= PROBES and finer(step) is not None:
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
    return BayesProgress(
        done=len(steps),
        total=total,
        unknowns=len(steps[-1].covariance),
        defect=defect,
        noise=chosen.noise,
        log_evidence=chosen.log_evidence,
    )


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
