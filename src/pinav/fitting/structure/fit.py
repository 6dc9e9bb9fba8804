"""`fit_structured`: the structure that the evidence prefers; whether a force turns.

Data that are worth it are linearised about the first steps of free kernels, and terms
are sought in them (`Search`). About the first steps of their own fit the data are asked
again, until the kinds of terms stay. The fit of the terms beside free kernels, that of
free kernels alone, and in a plane that of kernels that may turn are compared by their
evidence. A network learns from the fit of kernels that this gives.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np

from pinav.dynamics import FixedStep, Swimmer
from pinav.errors import FitError
from pinav.fitting.bayes.fit_bayes import NOT_FINITE, fit_bayes
from pinav.fitting.bayes.neural import FitSpecification
from pinav.fitting.bayes.parameters import Learn
from pinav.fitting.engine.evidence_fit import EvidenceFit, evidence_fit
from pinav.fitting.engine.iterate import EvidenceProgress, iterate
from pinav.fitting.engine.problem import Step
from pinav.fitting.environments.refinement import AS_FINE_AS_ASKED
from pinav.fitting.evidence.model_evidence import model_evidence
from pinav.fitting.outcome import Outcome
from pinav.fitting.rugged.free import fit_free, has_many_hills
from pinav.fitting.structure.fits import (
    Fits,
    StructuredFit,
    evidence_of,
    stands_alone,
)
from pinav.fitting.structure.kinds import signature
from pinav.fitting.structure.laws import follow_laws
from pinav.fitting.structure.policy import POLICY
from pinav.fitting.structure.rotation import (
    SurveyedRotation,
    fitted_gain,
    survey_rotation,
)
from pinav.fitting.structure.search import preferred, refine, simplify
from pinav.fitting.structure.survey import (
    Survey,
    is_network,
    is_worth_a_search,
    may_turn,
)
from pinav.fitting.structure.trace import Trace
from pinav.fitting.structure.trials import Proposal, polish
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
        trace = Trace(budget)
        if is_network(model):
            return _fit_student(
                specification, max_iterations, on_step, throw=throw, budget=budget
            )
        fits = Fits(specification, max_iterations, on_step, throw, trace)
        weigh_rotation &= may_turn(model)
        if is_worth_a_search(model, trajectories):
            found = _search(fits, weigh_rotation=weigh_rotation)
        else:
            found = _weigh_few(fits) if weigh_rotation else fit_free(fits)
        return dataclasses.replace(found, trace=tuple(trace.hypotheses))


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
    if taught.fit.outcome is Outcome.DIVERGED:
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
    if kernels.is_conservative or kernels.dim != PLANE:
        return kernels, False
    centers, width = kernels.kernels
    return KernelPotential.with_zero_weights(np.asarray(centers), float(width)), True


PLANE = 2
"""Dimension in which a rotation is weighed."""


def _search(fits: Fits, *, weigh_rotation: bool) -> StructuredFit:
    """The best fit of free kernels and of terms that data show."""
    fits, survey, is_rugged = survey_first_steps(fits)
    asked = _asked(fits, survey) if weigh_rotation else SurveyedRotation(np.nan)
    turns = asked.is_plain or not fits.kernels.is_conservative
    free, found = None, []
    if is_rugged and not turns:
        found = _proposals(survey, rotational=False, singles_only=True)
        if asked.is_needed and not found:
            found = _proposals(survey, rotational=True, singles_only=True)
            turns = len(found) > 0
    if is_rugged and not (turns or found):
        # Finer kernels show what smoothing hides.
        free = fit_free(fits)
        if has_many_hills(free.force):
            return _weigh_beside(fits, free) if weigh_rotation else free
        noise = free.fit.hyperparameters.noise
        if noise <= POLICY.explained * survey.noise:
            fits, survey = fits.about(free.fit), Survey.of(fits, free.fit)
            asked = _asked(fits, survey) if weigh_rotation else asked
            turns = asked.is_plain
    found = found or _proposals(survey, rotational=turns)
    is_explained = any(survey.explains(one) for one in found)
    if weigh_rotation and asked.is_needed and not (turns or is_explained):
        turning = _proposals(survey, rotational=True)
        turns = any(survey.explains(one) for one in turning)
        found = turning if turns else found
    if turns and weigh_rotation:
        turning = _turning(fits, found)
        if turning is not None and turning.rotation > POLICY.decisive:
            return turning
        found = [one for one in found if not any(t.rotational for t in one.terms)]
    best = functools.partial(_best, fits, found, free)
    if not weigh_rotation:
        return best()
    still, is_potential = _potential(fits, found, best)
    if not is_potential:
        return still
    if not asked.gain > POLICY.decisive:  # which may be NaN
        return StructuredFit(still.fit, still.gain, asked.gain)
    return _weigh_beside(fits, still)


def _potential(
    fits: Fits, proposals: Sequence[Proposal], fit: Callable[[], StructuredFit]
) -> tuple[StructuredFit, bool]:
    """The fit of a potential, or where that fails one of a mixture; which of them."""
    try:
        still = fit()
    except FitError:
        turning = _turning(fits, proposals)
        if turning is None:
            raise
        return turning, False
    if still.fit.outcome is Outcome.DIVERGED:
        return _turning(fits, proposals) or still, False
    return still, True


def survey_first_steps(fits: Fits) -> tuple[Fits, Survey, bool]:
    """A survey about the first steps of free kernels, and fits from there.

    Smoothed states miss the path of quick swimmers, so that data linearised about them
    suggest spurious forces. They are kept where free kernels do not explain the data,
    as a potential cannot those of a swirl; last, whether these must be finer.
    """
    survey, begun = Survey.of(fits), fits.begin()
    if begun is None:
        return fits, survey, False
    chosen = begun.hyperparameters
    if chosen.noise > POLICY.explained * survey.noise:
        is_rugged = AS_FINE_AS_ASKED.is_needed(fits.kernels, chosen.shape)
        return fits, survey, is_rugged
    return fits.about(begun), Survey.of(fits, begun), False


def _asked(fits: Fits, survey: Survey) -> SurveyedRotation:
    return survey_rotation(survey.response, survey.noise, (), fits.kernels.kernels)


def _proposals(
    survey: Survey, *, rotational: bool, singles_only: bool = False
) -> list[Proposal]:
    """Proposals that are worth a fit, those preferred by the evidence first.

    About smoothed states the right terms may leave much; a few steps of the fit of
    wrong ones lead to better states. In space one that explains the data but roughly is
    not worth the time of its fit.
    """
    found = survey.search(rotational=rotational).run(singles_only=singles_only)
    is_planar = survey.region.is_planar
    most = POLICY.hopeless if is_planar else POLICY.explained
    if survey.is_begun or singles_only or not is_planar:
        found = [one for one in found if one.noise <= most * survey.noise]
    # In space the kernels of the search are half as many as those of a fit.
    return found if is_planar else [refine(one, survey.response, 1) for one in found]


def _best(
    fits: Fits, proposals: Sequence[Proposal], free: StructuredFit | None = None
) -> StructuredFit:
    """The best of the fits of proposals, until one converges, and of free kernels.

    Args:
        free: the fit of free kernels alone, if there is one.
    """
    tried: list[EvidenceFit] = []
    for proposal in proposals[: POLICY.fitted]:
        fit = _fit_until_kinds_stay(fits, proposal)
        tried += [] if fit is None else [fit]
        if fit is not None and fit.outcome is Outcome.CONVERGED:
            break
    if not tried:
        return fit_free(fits) if free is None else free
    best = max(tried, key=evidence_of)
    return _against_free(fits, _with_laws(fits, best), free)


def _fit_until_kinds_stay(
    fits: Fits, proposal: Proposal, rounds: int = POLICY.rounds
) -> EvidenceFit | None:
    """The fit of terms that the data linearised about it confirm; None where it fails.

    Terms that explain data linearised about other states may be needless, misplaced or
    too few. So their fit is interrupted after a few steps, and about these they are
    polished, and where they leave more than the noise, all terms are sought again.
    """
    begun = fits.beside(proposal.terms).begin()
    if begun is None:
        fits.trace.note(proposal.terms, "the first steps of its fit diverged")
        return None
    survey = Survey.of(fits, begun)
    here = polish(begun.model.environment.terms, survey.response)
    here = here and simplify(refine(here, survey.response), survey.response)
    if here is None or here.noise > POLICY.settled * survey.noise:
        lawful = here and _fit_laws_early(fits, here, survey, begun)
        if lawful is not None:
            return lawful
        here = _sought_again(fits, survey, here, proposal)
    if here is None:
        fits.trace.note(proposal.terms, "about its own fit it explains no more")
        return None
    is_same = signature(here.terms) == signature(proposal.terms)
    if not is_same and rounds > 1 and not fits.trace.is_over:
        fits.trace.note(proposal.terms, "about its own fit other terms are preferred")
        return _fit_until_kinds_stay(fits.about(begun), here, rounds - 1)
    if not survey.explains(here):
        left = here.noise / survey.noise
        fits.trace.note(here.terms, "left too much", here.log_evidence, left)
        return None
    return fits.try_terms(here.terms, begun)


def _sought_again(
    fits: Fits, survey: Survey, here: Proposal | None, before: Proposal
) -> Proposal | None:
    """The best of terms and of those that a new search finds, if there is time.

    None where the terms are far from the noise and leave what they left before: a new
    search would end with them again.
    """
    if here is not None and not survey.explains(here):
        is_same = abs(here.noise / before.noise - 1) < POLICY.same
        if is_same:
            return None
    if fits.trace.is_over:
        return here
    turns = not fits.kernels.is_conservative or any(t.rotational for t in before.terms)
    found = survey.search(rotational=turns, content=POLICY.settled).run()
    found = [refine(one, survey.response) for one in found[:1]]
    several = found if here is None else [here, *found]
    return preferred(several)[0] if several else None


def _fit_laws_early(
    fits: Fits, proposal: Proposal, survey: Survey, begun: EvidenceFit
) -> EvidenceFit | None:
    """The fit of terms that follow laws, where those are all that is needed.

    About a centre the force of kernels vanishes; that of a wide ring does not, and
    other terms would be sought to make up for it.
    """
    if not survey.explains(proposal):
        return None
    lawful = follow_laws(proposal.terms, survey.response, proposal.noise)
    fit = lawful and fits.try_terms(lawful.terms, begun)
    if fit is None or fit.hyperparameters.noise > POLICY.lawful * survey.noise:
        return None
    is_whole = fit.outcome is Outcome.CONVERGED and stands_alone(fit)
    return fit if is_whole else None


def _with_laws(fits: Fits, fit: EvidenceFit) -> EvidenceFit:
    """The fit whose profiles follow laws, where that is as good."""
    if fits.trace.is_over:
        return fit
    response = Survey.of(fits, fit).response
    terms, noise = fit.model.environment.terms, fit.hyperparameters.noise
    lawful = follow_laws(terms, response, noise)
    other = lawful and fits.try_terms(lawful.terms, fit)
    if other is None or other.outcome is not Outcome.CONVERGED:
        return fit
    is_as_good = evidence_of(other) > evidence_of(fit) - POLICY.decisive
    return other if is_as_good else fit


def _against_free(
    fits: Fits, structured: EvidenceFit, free: StructuredFit | None
) -> StructuredFit:
    """The fit of terms or that of free kernels alone, by their evidence.

    The free fit begins where the other ended, and ends early where it cannot win. Where
    the evidence cannot tell, terms that need nothing beside them are preferred: they
    are simpler, and say more where there are no data.
    """
    if fits.trace.is_over:
        return StructuredFit(structured)
    best = structured.hyperparameters.log_evidence
    terms = structured.model.environment.terms
    turns = any(term.rotational for term in terms) and fits.kernels.is_conservative
    alone = fits.turning() if turns else fits

    def is_coarse(step: Step) -> bool:
        return AS_FINE_AS_ASKED.is_needed(alone.kernels, step.hyperparameters.shape)

    def has_lost(step: Step) -> bool:
        return step.hyperparameters.log_evidence < best - POLICY.clear

    problem = alone.about(structured).problem()
    outcome, steps = iterate(
        problem,
        fits.max_iterations,
        alone.report,
        lambda step: is_coarse(step) or has_lost(step),
    )
    if not steps:
        return StructuredFit(structured)
    last = steps[-1]
    value = model_evidence(problem.linear_fit(last), last.hyperparameters).log_evidence
    gain = evidence_of(structured) - value
    fits.trace.note((), "free kernels from the states of the terms", value)
    if gain > POLICY.decisive or (
        gain > -2 * POLICY.decisive and stands_alone(structured)
    ):
        return StructuredFit(structured, gain)
    if outcome is Outcome.CONVERGED and not is_coarse(last):
        fit = evidence_fit(problem, outcome, steps, not_finite=NOT_FINITE, advice={})
        return StructuredFit(fit, gain)
    try:
        free = fit_free(alone) if free is None else free
    except FitError:
        return StructuredFit(structured, gain)
    if evidence_of(free.fit) < evidence_of(structured) - POLICY.decisive:
        return StructuredFit(structured, gain)
    return free if free.structure else StructuredFit(free.fit, gain)


def _turning(fits: Fits, proposals: Sequence[Proposal]) -> StructuredFit | None:
    """The best fit beside kernels that may turn; None where it fails."""
    try:
        best = _best(fits.turning(), proposals)
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
    turning, rotation = None, asked.gain
    if rotation > POLICY.decisive and not fits.trace.is_over:
        turning = _turning(fits, ())
        rotation = np.nan if turning is None else turning.rotation
    if turning is None or not rotation > POLICY.decisive:
        return StructuredFit(still.fit, still.gain, rotation)
    is_better = evidence_of(turning.fit) > evidence_of(still.fit)
    return turning if is_better or not has_many_hills(still.force) else still


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
    rotation = evidence_of(coarse) - evidence_of(still.fit)
    turning = _turning(fits, ()) if rotation > POLICY.decisive else None
    if turning is None:
        return StructuredFit(still.fit, still.gain, rotation)
    rotation = evidence_of(turning.fit) - evidence_of(still.fit)
    chosen = turning if rotation > POLICY.decisive else still
    return StructuredFit(chosen.fit, chosen.gain, rotation)
