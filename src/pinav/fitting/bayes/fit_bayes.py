"""`fit_bayes`: an environment from noisy data, with everything it needs.

Lifted Gauss-Newton steps with the starts eliminated; at every step the evidence
chooses shape of the prior, amplitude and noise anew, so that nothing is set by hand.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from pinav.dynamics import AbstractDynamics, FixedStep
from pinav.errors import FitError, InputError
from pinav.fitting.bayes.iterate import EvidenceProgress, iterate
from pinav.fitting.bayes.neural import FitSpecification
from pinav.fitting.bayes.parameters import learned_environment
from pinav.fitting.bayes.problem import BayesProblem, Step
from pinav.fitting.engine.evidence_fit import EvidenceFit
from pinav.fitting.engine.posterior import Estimate
from pinav.fitting.environments.refinement import AS_FINE_AS_ASKED, Refinement
from pinav.fitting.outcome import Outcome
from pinav.forces import AbstractForce
from pinav.trajectories import Trajectories


def fit_bayes(
    model: AbstractDynamics,
    trajectories: Trajectories,
    *,
    learn: Callable[[Any], PyTree] | None = lambda _: (),
    noise: float | None = None,
    solver: FixedStep | None = None,
    refine: Refinement | None = AS_FINE_AS_ASKED,
    max_iterations: int = 20,
    on_step: Callable[[EvidenceProgress], None] | None = None,
    throw: bool = True,
) -> EvidenceFit:
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
            parametric force. None where all of the model is known: the starts alone
            are sought, and its evidence.
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
        request = FitSpecification(model, trajectories, learn, noise, solver)
        grids = _Grids(request.problem, refine, trajectories)
        result = _result(
            *_refined(_begun(request, grids), grids, max_iterations, on_step)
        )
    if throw and result.outcome in _MESSAGES:
        raise FitError(_MESSAGES[result.outcome])
    return result


_MESSAGES = {
    Outcome.STALLED: (
        "the fit stalled: its iterations ran out before the states fulfilled the "
        "dynamics; raise max_iterations, or pass throw=False to get what was reached"
    ),
    Outcome.DIVERGED: (
        "the fit diverged: the states depart from the dynamics; check the known "
        "forces, add substeps, or pass throw=False to get what was reached"
    ),
}


def _begun(request: FitSpecification, grids: "_Grids") -> BayesProblem:
    """The fit at its start: from the model's values, or taught by a kernel fit."""
    environment = learned_environment(request.model)
    if environment is None or environment.is_linear or request.learn is None:
        return request.problem(request.model)
    teaching, outcome, steps = _refined(request.by_kernels(), grids, TEACHING_STEPS)
    if outcome is Outcome.DIVERGED:
        return request.problem(request.model)
    return request.taught(teaching, steps[-1])


TEACHING_STEPS = 20
"""Of the kernel fit at most."""


class _Grids(eqx.Module):
    """How a fit goes on where its kernels are too coarse."""

    begin: Callable[..., BayesProblem]
    refine: Refinement | None
    trajectories: Trajectories

    def wanted(self, problem: BayesProblem, step: Step) -> bool:
        """Whether the kernels are too coarse."""
        shape = step.inference.hyperparameters.shape
        environment = problem.free.static.environment
        return self.refine is not None and self.refine.wanted(environment, shape)

    def environment(self, problem: BayesProblem, step: Step) -> AbstractForce | None:
        """Finer kernels; None where they are not wanted, or too many."""
        if self.refine is None or not self.wanted(problem, step):
            return None
        return self.refine.finer(problem.free.static.environment, self.trajectories)

    def finer(self, problem: BayesProblem, step: Step) -> BayesProblem | None:
        """The fit on finer kernels, if there are any."""
        environment = self.environment(problem, step)
        if environment is None:
            return None
        model = problem.free(jnp.asarray(problem.theta))
        model = eqx.tree_at(lambda m: m.environment, model, environment)
        return self.begin(model, states=problem.states)


def _refined(
    problem: BayesProblem,
    grids: _Grids,
    max_iterations: int,
    on_step: Callable[[EvidenceProgress], None] | None = None,
) -> tuple[BayesProblem, Outcome, list[Step]]:
    """Steps on kernels as fine as the evidence asks for.

    Each grid begins anew, so that the result is that of its own fit.
    """

    def enough(step):
        return grids.environment(problem, step) is not None

    outcome, steps = iterate(problem, max_iterations, on_step, enough)
    better = grids.finer(problem, steps[-1]) if steps else None
    if better is not None:
        return _refined(better, grids, max_iterations, on_step)
    if outcome is Outcome.CONVERGED and grids.wanted(problem, steps[-1]):
        outcome = Outcome.UNDER_RESOLVED
    return problem, outcome, steps


def _result(problem: BayesProblem, outcome: Outcome, steps: list[Step]) -> EvidenceFit:
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
    return EvidenceFit(
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
