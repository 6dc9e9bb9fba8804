"""`fit_structured`: the structure that the evidence prefers; whether a force turns.

Data that are worth it are linearised about the first steps of free kernels, and terms
are sought in them (`Search`). About the first steps of their own fit the data are asked
again, until the kinds of terms stay. The fit of the terms beside free kernels, that of
free kernels alone, and in a plane that of kernels that may turn are compared by their
evidence. A network learns from the fit of kernels that this gives.
"""

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np

from pinav.dynamics import FixedStep, Swimmer
from pinav.errors import FitError
from pinav.fitting.bayes.fit_bayes import fit_bayes
from pinav.fitting.bayes.neural import FitSpecification
from pinav.fitting.bayes.parameters import Learn
from pinav.fitting.confirmed import best_fit
from pinav.fitting.engine.evidence_fit import EvidenceProgress
from pinav.fitting.outcome import Outcome
from pinav.fitting.policy import POLICY
from pinav.fitting.rugged.free import fit_free, fit_rough
from pinav.fitting.rugged.pieces import fit_pieces
from pinav.fitting.structure.fits import Fits, StructuredFit
from pinav.fitting.structure.rotation import (
    SurveyedRotation,
    fitted_gain,
    survey_rotation,
)
from pinav.fitting.structure.survey import (
    Survey,
    is_network,
    is_worth_a_search,
    may_turn,
    survey_about,
)
from pinav.fitting.structure.trace import Trace
from pinav.fitting.structure.trials import Proposal
from pinav.forces import AbstractLearnedForce, KernelPotential, split_structure
from pinav.numerics import free_programs
from pinav.trajectories import Trajectories, with_velocities


def fit_structured(
    model: Any,
    trajectories: Trajectories,
    *,
    learn: Learn = lambda _: (),
    noise: float | None = None,
    solver: FixedStep | None = None,
    max_iterations: int = 20,
    on_step: Callable[[EvidenceProgress], None] | None = None,
    weigh_rotation: bool = False,
    throw: bool = True,
    budget: float = np.inf,
) -> StructuredFit:
    """Fit kernels, and a structured force where the data show one; see `fit_bayes`.

    A network is distilled from such a fit of kernels, in place of one of free kernels.
    One that may turn, or that sees the time, learns in a plane from whichever of a
    potential and a mixture the evidence prefers, any other from kernels of its kind.

    Args:
        model: dynamics whose environment is a `KernelPotential`, a `KernelForce` or a
            `KernelMixture`, or a network.
        weigh_rotation: fit a `KernelMixture` in place of a `KernelPotential` where the
            evidence of planar data, however few, prefers a rotational part, or the
            potential alone diverges. Of a network its kind decides.
        budget: time after which nothing more is tried, and the best fit so far is the
            result, once the fit in progress has ended [s].

    Raises:
        FitError: as `fit_bayes` does.
    """
    free_programs()
    if isinstance(model, Swimmer):
        trajectories = with_velocities(trajectories)
    with jax.enable_x64(new_val=True):
        solver = FixedStep() if solver is None else solver
        specification = FitSpecification(model, trajectories, learn, noise, solver)
        if is_network(model):
            return _fit_student(
                specification, max_iterations, on_step, throw=throw, budget=budget
            )
        trace = Trace(budget)
        fits = Fits(specification, max_iterations, on_step, throw, trace)
        weigh_rotation &= may_turn(model)
        if is_worth_a_search(model, trajectories):
            fit = _search(fits, weigh_rotation=weigh_rotation)
        else:
            fit = _weigh_few(fits) if weigh_rotation else fit_free(fits)
        if fit.fit.outcome is Outcome.DIVERGED:
            alone = fits.turning() if weigh_rotation else fits
            pieces = fit_pieces(alone, fit.fit)
            trace.note((), f"free kernels of pieces of trajectories {pieces.outcome}")
            fit = StructuredFit(pieces)
        return dataclasses.replace(fit, trace=tuple(trace.hypotheses))


def _fit_student(
    specification: FitSpecification,
    max_iterations: int,
    on_step: Callable[[EvidenceProgress], None] | None,
    *,
    throw: bool,
    budget: float,
) -> StructuredFit:
    """The fit of a network, taught by that of kernels where data are worth a search."""
    data, model = specification.trajectories, specification.model
    learning = functools.partial(
        fit_bayes,
        model,
        data,
        learn=specification.learn,
        noise=specification.noise,
        solver=specification.solver,
        max_iterations=max_iterations,
        on_step=on_step,
        throw=throw,
    )
    if not is_worth_a_search(model, data):
        return StructuredFit(learning())
    kernels, weigh_rotation = kernels_of_teacher(specification)
    pupil = eqx.tree_at(lambda m: m.environment, model, kernels)
    options = learning.keywords | {"throw": False, "budget": budget}
    try:
        taught = fit_structured(pupil, data, weigh_rotation=weigh_rotation, **options)
    except FitError:  # as of a potential, where the force turns
        return StructuredFit(learning())
    if taught.fit.outcome in (Outcome.DIVERGED, Outcome.MISFIT):
        return StructuredFit(learning())
    fit = learning(teacher=taught.fit)
    return StructuredFit(fit, taught.gain, taught.rotation, taught.fit, taught.trace)


def kernels_of_teacher(
    specification: FitSpecification,
) -> tuple[AbstractLearnedForce, bool]:
    """Untrained kernels for a network to learn from; whether to weigh a rotation.

    A potential comes first where a rotation can be weighed, since a force of
    independent components has no structure to find.
    """
    kernels: Any = specification.kernels()
    if kernels.is_conservative or kernels.dim != 2:
        return kernels, False
    centers, width = kernels.kernels
    return KernelPotential.with_zero_weights(np.asarray(centers), float(width)), True


def _search(fits: Fits, *, weigh_rotation: bool) -> StructuredFit:
    """The best fit of free kernels and of terms that data show."""
    fits, survey = survey_first_steps(fits)
    asked = (
        _weigh_in_survey(fits, survey) if weigh_rotation else SurveyedRotation(np.nan)
    )
    is_plain = asked.is_plain or not fits.kernels.is_conservative
    search = survey.search(rotational=is_plain or asked.is_needed)
    rough, proposals = None, []
    if not (survey.is_begun or is_plain):
        proposals = survey.propose(search, singles_only=True)
        if not proposals:
            # Terms are sought about states that explain the data, as finer kernels do.
            with contextlib.suppress(FitError):
                rough = fit_rough(fits)
                fits, survey = survey_about(fits, rough, survey)
            if survey.is_begun:  # what a potential explains needs no rotation
                search = survey.search(rotational=False)
    proposals = proposals or survey.propose(search)
    if weigh_rotation and (asked.is_plain or _turns(proposals[:1])):
        turning = _fit_turning(fits, proposals)
        if turning is not None and turning.rotation > POLICY.decisive:
            return turning
        proposals = [one for one in proposals if not _turns([one])]
    best = functools.partial(best_fit, fits, proposals, rough)
    if not weigh_rotation:
        return best()
    still, is_potential = _potential(fits, proposals, best)
    if not is_potential:
        return still
    if not asked.gain > POLICY.decisive:  # which may be NaN
        return StructuredFit(still.fit, still.gain, asked.gain)
    return _weigh_beside(fits, still)


def _turns(proposals: Sequence[Proposal]) -> bool:
    return any(term.rotational for one in proposals for term in one.terms)


def _potential(
    fits: Fits, proposals: Sequence[Proposal], fit: Callable[[], StructuredFit]
) -> tuple[StructuredFit, bool]:
    """The fit of a potential, or where that fails one of a mixture; which of them."""
    try:
        still = fit()
    except FitError:
        turning = _fit_turning(fits, proposals)
        if turning is None:
            raise
        return turning, False
    if still.fit.outcome is Outcome.DIVERGED:
        return _fit_turning(fits, proposals) or still, False
    return still, True


def survey_first_steps(fits: Fits) -> tuple[Fits, Survey]:
    """A survey about the first steps of free kernels, and fits from there.

    Smoothed states miss the path of quick swimmers, so that data linearised about them
    suggest spurious forces. They are kept where free kernels do not explain the data,
    as a potential cannot those of a swirl.
    """
    return survey_about(fits, fits.begin(), Survey.of(fits))


def _weigh_in_survey(fits: Fits, survey: Survey) -> SurveyedRotation:
    return survey_rotation(survey.response, survey.noise, (), fits.kernels.kernels)


def _fit_turning(fits: Fits, proposals: Sequence[Proposal]) -> StructuredFit | None:
    """The best fit beside kernels that may turn; None where it fails."""
    try:
        best = best_fit(fits.turning(), proposals)
    except FitError:
        return None
    if best.fit.outcome is Outcome.DIVERGED:
        return None
    return StructuredFit(best.fit, best.gain, fitted_gain(best.fit))


def _weigh_beside(fits: Fits, still: StructuredFit) -> StructuredFit:
    """The fit of a potential, or of a mixture where the data about it ask for one."""
    force = still.fit.model.environment
    terms, _ = split_structure(force)
    about = Survey.of(fits, still.fit)
    asked = survey_rotation(about.response, about.noise, terms, force.kernels)
    return _weigh_mixture(fits, still, asked.gain)


def _weigh_few(fits: Fits) -> StructuredFit:
    """The fit of a potential or of a mixture, to data too few for a search.

    A potential that is refined may follow a few trajectories whatever the force is, so
    that nothing linearised about it asks for more. A mixture on the kernels with which
    fits begin costs little and, where the force turns, needs no finer ones to explain
    the data better.
    """
    still, is_potential = _potential(fits, (), functools.partial(fit_free, fits))
    coarse = fits.turning().try_terms(()) if is_potential else None
    if coarse is None:
        return still
    return _weigh_mixture(fits, still, coarse.log_evidence - still.log_evidence)


def _weigh_mixture(fits: Fits, still: StructuredFit, rotation: float) -> StructuredFit:
    """The fit of a potential, or that of a mixture where its evidence is higher.

    Args:
        rotation: evidence of a rotational part that is known before it is fitted
            [nats]; unless it is decisive none is.
    """
    turning = None
    if rotation > POLICY.decisive and not fits.trace.is_over:
        turning = _fit_turning(fits, ())
        rotation = np.nan
    if turning is None:
        return StructuredFit(still.fit, still.gain, rotation)
    rotation = turning.log_evidence - still.log_evidence
    chosen = turning if rotation > POLICY.decisive else still
    return StructuredFit(chosen.fit, chosen.gain, rotation)
