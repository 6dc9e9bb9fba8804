"""Steps of a fit with the evidence, and how they end."""

from collections.abc import Callable

import equinox as eqx

from pinav.errors import FitError
from pinav.fitting.engine.problem import AbstractProblem, Move, Step
from pinav.fitting.evidence.evidence import Hyperparameters
from pinav.fitting.outcome import Outcome

DEFECT_TOLERANCE = 1e-4
"""Converged: defects relative to the states' spread."""

ROUNDING = 1e-9
"""Defects at which another step changes nothing but the last digits of the evidence."""


class EvidenceProgress(eqx.Module):
    """What a progress bar shows after each step.

    Attributes:
        done: steps done, on the kernels as they are now.
        defect: by which the states miss the dynamics, relative to their spread.
        force: name of the force, where one fit tries several.
    """

    done: int
    total: int
    parameters: int
    defect: float
    noise: float
    log_evidence: float
    force: str = ""


PROBES = 2
"""Steps after which the evidence is asked whether the kernels are too coarse."""


def iterate(
    problem: AbstractProblem,
    max_iterations: int,
    on_step: Callable[[EvidenceProgress], None] | None = None,
    enough: Callable[[Step], bool] = lambda _: False,
) -> tuple[Outcome, list[Step]]:
    """Steps until they converge, diverge, run out, or are not worth going on with.

    Args:
        enough: whether another problem is better, after `PROBES` steps or more.
    """
    move = Move(problem.theta, problem.states, problem.step_rule)
    chosen: Hyperparameters | None = None
    steps: list[Step] = []
    is_settled, is_moved = False, False
    while len(steps) < max_iterations:
        step = _attempt(problem, move, chosen)
        if step is None:
            return Outcome.DIVERGED, steps
        move, chosen = step.move, step.hyperparameters
        steps.append(step)
        if on_step:
            on_step(_progress(steps, max_iterations))
        # A defect is that of the point from which a step goes: under another prior the
        # step may be long, and only the next one tells whether it led anywhere.
        outcome = Outcome.STALLED if is_moved else _outcome(steps, problem.tolerance)
        is_moved = False
        if outcome is Outcome.CONVERGED and not is_settled:
            # Each search begins where the last one ended, so that the first
            # linearisations, which are rough, may have led to a lower maximum.
            is_settled = True
            likelier = step.weights.search_anew(step.quadratic, chosen, problem.noise)
            if likelier is not None:
                chosen, is_moved = likelier, True
                continue
        if outcome is not Outcome.STALLED:
            return outcome, steps
        if len(steps) >= PROBES and enough(step):
            return outcome, steps
    return Outcome.STALLED, steps


def _attempt(
    problem: AbstractProblem, move: Move, before: Hyperparameters | None
) -> Step | None:
    """One step; None where it leads nowhere, after others that did."""
    try:
        return problem.step(move, before)
    except FitError:
        if before is not None:
            return None
        raise


def _progress(steps: list[Step], total: int) -> EvidenceProgress:
    chosen, defect = steps[-1].hyperparameters, steps[-1].defect
    return EvidenceProgress(
        done=len(steps),
        total=total,
        parameters=len(steps[-1].covariance),
        defect=defect,
        noise=chosen.noise,
        log_evidence=chosen.log_evidence,
    )


def _outcome(steps: list[Step], tolerance: float) -> Outcome:
    """Converged, or not yet; defects that grow without bound count as diverged."""
    last = steps[-1]
    if len(steps) > 1:
        before = steps[-2].hyperparameters.log_evidence
        change = abs(last.hyperparameters.log_evidence - before)
        # The evidence alone may stand still while the states do not yet obey the model.
        if change < tolerance and last.defect < DEFECT_TOLERANCE:
            return Outcome.CONVERGED
    if last.defect < ROUNDING:
        return Outcome.CONVERGED
    if last.defect > 100 * max(steps[0].defect, 1.0):
        return Outcome.DIVERGED
    return Outcome.STALLED
