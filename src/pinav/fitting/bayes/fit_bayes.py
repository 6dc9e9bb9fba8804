"""`fit_bayes`: an environment from noisy data, with everything it needs.

Lifted Gauss-Newton steps with the starts eliminated; at every step the evidence
chooses shape of the prior, amplitude and noise anew, so that nothing is set by hand.
"""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from pinav.dynamics import AbstractDynamics, FixedStep, Swimmer
from pinav.errors import InputError
from pinav.fitting.bayes.neural import FitSpecification, Teacher
from pinav.fitting.bayes.parameters import Learn, learned_environment
from pinav.fitting.bayes.problem import BayesProblem
from pinav.fitting.engine.evidence_fit import (
    EvidenceFit,
    EvidenceProgress,
    evidence_fit,
    iterate,
)
from pinav.fitting.engine.problem import AbstractProblem, Step
from pinav.fitting.environments.kernels import check_size
from pinav.fitting.environments.refinement import (
    AS_FINE_AS_ASKED,
    Refinement,
    iterate_refined,
)
from pinav.fitting.evidence.model_evidence import model_evidence
from pinav.fitting.outcome import Outcome
from pinav.fitting.policy import POLICY
from pinav.numerics import free_programs
from pinav.settings import MAX_STEPS
from pinav.trajectories import Trajectories, with_velocities


def fit_bayes(
    model: AbstractDynamics,
    trajectories: Trajectories,
    *,
    learn: Learn = lambda _: (),
    noise: float | None = None,
    solver: FixedStep | None = None,
    refine: Refinement | None = AS_FINE_AS_ASKED,
    max_iterations: int = MAX_STEPS,
    on_step: Callable[[EvidenceProgress], None] | None = None,
    teacher: EvidenceFit | None = None,
    throw: bool = True,
) -> EvidenceFit:
    r"""Fit the environment of a swimmer, and constants, to noisy trajectories.

    The weights of a kernel environment have a Gaussian-process prior. A network is
    distilled from a kernel fit, whose process is then the prior of its forces; a
    network that sees the time has independent weights of one variance instead, and
    bands that are too wide (docs/evidence.md), unless a `teacher` is given whose
    process explains the data better. All starts have a flat prior, as have
    constants and parametric environments unless a prior is given. The rollout is a
    strong constraint: no process noise. The result needs neither velocities nor regular
    times. A constant force along the thrust is hard to tell from a wide slope of the
    environment; where the
    thrust is learned, its standard deviation says so.

    Args:
        model: dynamics with a field `environment`, of second order (`Swimmer`) or,
            where the state is the position, of first. With kernels or a network,
            such as `kernel_environment` and `neural_environment` make, all weights
            are learned; with any other force what `learn` picks of it. The fit starts
            from the model's values.
        trajectories: what was observed; any entries may be missing, and the velocities
            of a swimmer with inertia altogether.
        learn: picks a constant to learn too, such as `lambda m: m.drag.damping`, or
            a tuple of them; `lambda m: m.environment` picks all numbers of a
            parametric force. Numbers with priors are given as `FreeNumber` values, such
            as those of `System.learn`. None where all of the model is known: the starts
            alone are sought, and its evidence.
        noise: standard deviation of the observations; estimated unless given.
        solver: steps between samples; `FixedStep()` unless given.
        refine: when kernels turn out too coarse, and the fit begins anew on finer
            ones; None keeps them.
        max_iterations: after which the fit counts as stalled.
        teacher: of a network: a fit of the same data, of kernels with structured terms
            or without. Kernels of the same kind are fitted first unless given.
        throw: raise where the fit did not converge.

    Raises:
        InputError: there is nothing to learn, the trajectories are not its own, or are
            too few, or `noise` is not positive.
        FitError: the data do not determine the constants or a start, or the fit did
            not converge and `throw` is true.
    """
    _check(model, noise, max_iterations)
    free_programs()
    if isinstance(model, Swimmer):
        trajectories = with_velocities(trajectories)
    with jax.enable_x64(new_val=True):
        solver = FixedStep() if solver is None else solver
        specification = FitSpecification(model, trajectories, learn, noise, solver)
        if teacher is None:
            ended = iterate_refined(
                _first_problem(specification, refine),
                specification.problem,
                refine,
                trajectories,
                max_iterations,
                on_step,
            )
        else:
            fitted = Teacher.of_fit(teacher)
            ended = _learn(specification, fitted, max_iterations, on_step)
        return evidence_fit(
            *ended, not_finite=NOT_FINITE, advice=ADVICE if throw else {}
        )


NOT_FINITE = (
    "the model's rates of change are not finite at the observed states; check its "
    "constants"
)

ADVICE = {
    Outcome.STALLED: (
        "the fit stalled: its iterations ran out before the states fulfilled the "
        "dynamics; raise max_iterations, or pass throw=False to get what was reached"
    ),
    Outcome.DIVERGED: (
        "the fit diverged: the states depart from the dynamics; check the known "
        "forces, add substeps, or pass throw=False to get what was reached"
    ),
}


def _first_problem(
    specification: FitSpecification, refine: Refinement | None
) -> BayesProblem:
    """From the model's values; a network is distilled from a kernel fit first."""
    model, learn = specification.model, specification.learn
    environment = learned_environment(model)
    check_size(environment)
    if environment is None or environment.is_linear or learn is None:
        return specification.problem(model)
    kernels, outcome, steps = iterate_refined(
        specification.by_kernels(),
        specification.problem,
        refine,
        specification.trajectories,
        KERNEL_STEPS,
    )
    if outcome is Outcome.DIVERGED:
        return specification.problem(model)
    teacher = Teacher.of_step(kernels, steps[-1])
    network, targets = specification.distill(teacher)
    if environment.is_static:
        return specification.by_process(teacher, network, targets)
    return specification.by_weights(teacher, network)


KERNEL_STEPS = 20
"""Of the kernel fit at most."""


def _learn(
    specification: FitSpecification,
    teacher: Teacher,
    max_iterations: int,
    on_step: Callable[[EvidenceProgress], None] | None,
) -> tuple[AbstractProblem, Outcome, list[Step]]:
    """Fit a network that is distilled from a given teacher.

    The process of a teacher does not change with time. A network that sees the time has
    it as its prior where the evidence does not prefer weights of one variance, as it
    does where the force changes.
    """
    network, targets = specification.distill(teacher)
    still = specification.by_process(teacher, network, targets)
    outcome, steps = iterate(still, max_iterations, on_step)
    if network.is_static:
        return still, outcome, steps
    best = evidence_of_steps(still, steps)

    def has_lost(step: Step) -> bool:
        return step.hyperparameters.log_evidence < best - POLICY.clear

    free = specification.by_weights(teacher, network)
    freed = iterate(free, max_iterations, on_step, has_lost)
    if outcome is not Outcome.DIVERGED and best >= evidence_of_steps(free, freed[1]):
        return still, outcome, steps
    return free, *freed


def evidence_of_steps(problem: AbstractProblem, steps: list[Step]) -> float:
    """Log evidence after the last of some steps; of none that of no model."""
    if not steps:
        return -np.inf
    linear, chosen = problem.linear_fit(steps[-1]), steps[-1].hyperparameters
    return model_evidence(linear, chosen).log_evidence


def _check(model: Any, noise: float | None, max_iterations: int) -> None:
    if not hasattr(model, "environment"):
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
