"""Fits of proposed terms that the data linearised about them confirm.

Of what the search proposes the likeliest is fitted for a few steps, and about these the
data are asked again, until the kinds of terms stay; then it is fitted to the end, with
laws in place of profiles where that is as good, and compared with free kernels.
"""

import dataclasses
from collections.abc import Sequence

from pinav.errors import FitError
from pinav.fitting.bayes.fit_bayes import NOT_FINITE, evidence_of_steps
from pinav.fitting.engine.evidence_fit import EvidenceFit, evidence_fit, iterate
from pinav.fitting.engine.problem import Step
from pinav.fitting.environments.refinement import AS_FINE_AS_ASKED
from pinav.fitting.outcome import Outcome
from pinav.fitting.policy import POLICY
from pinav.fitting.rugged.free import fit_free, fit_rough
from pinav.fitting.structure.fits import Fits, StructuredFit
from pinav.fitting.structure.kinds import signature
from pinav.fitting.structure.laws import follow_laws
from pinav.fitting.structure.search import preferred, refine
from pinav.fitting.structure.survey import Survey, survey_about
from pinav.fitting.structure.trials import Proposal, polish


def best_fit(
    fits: Fits, proposals: Sequence[Proposal], rough: EvidenceFit | None = None
) -> StructuredFit:
    """The best of the fits of proposals, until one converges, and of free kernels.

    Args:
        rough: the fit of free kernels about which terms were sought, if there is one.
    """
    tried: list[StructuredFit] = []
    for proposal in proposals[: POLICY.fitted]:
        fit = _fit_until_kinds_stay(fits, proposal)
        tried += [] if fit is None else [fit]
        if fit is not None and fit.fit.outcome is Outcome.CONVERGED:
            break
    if not tried:
        return _best_about_free(fits, rough, proposals)
    best = max(tried, key=lambda one: one.log_evidence)
    return _against_free(fits, best, rough)


def _best_about_free(
    fits: Fits, rough: EvidenceFit | None, failed: Sequence[Proposal]
) -> StructuredFit:
    """The best fit of terms sought about free kernels, or that of free kernels.

    Args:
        failed: proposals of which no fit succeeded; about smoothed states, unless there
            is a fit of free kernels.
    """
    if rough is not None or not failed or fits.trace.is_over:
        return fit_free(fits, rough)
    rough = fit_rough(fits)
    about, survey = survey_about(fits, rough, Survey.of(fits))
    search = survey.search(rotational=not fits.kernels.is_conservative)
    proposals = survey.propose(search) if survey.is_begun else []
    return best_fit(about, proposals, rough)


def _fit_until_kinds_stay(
    fits: Fits, proposal: Proposal, rounds: int = POLICY.rounds
) -> StructuredFit | None:
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
    if here is not None:
        here = refine(survey.simplify(here), survey.response)
    is_settled = here is not None and here.noise <= POLICY.settled * survey.noise
    # what terms leave may be what the kernels of their profiles miss
    is_too_coarse = here is not None and here.finer is not None
    if not (is_settled or is_too_coarse):
        here = _search_again(fits, survey, here, proposal)
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
    return _fit_with_laws(fits, survey, here, begun)


def _fit_with_laws(
    fits: Fits, survey: Survey, proposal: Proposal, begun: EvidenceFit
) -> StructuredFit | None:
    """The fit of terms whose profiles follow laws, or of the kernels of the profiles.

    Laws carry what is steep, so that coarse kernels suffice beside them.
    """
    lawful = follow_laws(proposal.terms, survey.response, survey.region, proposal.noise)
    if lawful is not None:
        fit = fits.try_terms(lawful.terms, begun)
        most = POLICY.settled * max(survey.noise, proposal.noise)
        if (
            fit is not None
            and fit.fit.outcome is Outcome.CONVERGED
            and fit.fit.hyperparameters.noise <= most
        ):
            return fit
    return fits.try_terms(proposal.terms, begun)


def _search_again(
    fits: Fits, survey: Survey, here: Proposal | None, before: Proposal
) -> Proposal | None:
    """The best of terms and of those that a new search finds, if there is time.

    None where the terms are far from the noise and leave what they left before: a new
    search would end with them again.
    """
    is_same = here is not None and abs(here.noise / before.noise - 1) < POLICY.same
    if here is not None and is_same and not survey.explains(here):
        return None
    if fits.trace.is_over:
        return here
    turns = not fits.kernels.is_conservative or any(t.rotational for t in before.terms)
    proposals = survey.search(rotational=turns, content=POLICY.settled).run()
    several = [] if here is None else [here]
    best = [survey.simplify(one) for one in proposals[:1] if survey.explains(one)]
    several += [refine(one, survey.response) for one in best]
    return preferred(several)[0] if several else None


def _against_free(
    fits: Fits, structured: StructuredFit, rough: EvidenceFit | None
) -> StructuredFit:
    """The fit of terms or that of free kernels alone, by their evidence.

    The free fit begins where the other ended, and ends early where it cannot win. Where
    the evidence cannot tell, terms that need nothing beside them are preferred: they
    are simpler, and say more where there are no data.
    """
    if fits.trace.is_over:
        return structured
    best = structured.fit.hyperparameters.log_evidence
    terms = structured.fit.model.environment.terms
    turns = any(term.rotational for term in terms) and fits.kernels.is_conservative
    alone = fits.turning() if turns else fits

    def is_coarse(step: Step) -> bool:
        return AS_FINE_AS_ASKED.is_needed(alone.kernels, step.hyperparameters.shape)

    def has_lost(step: Step) -> bool:
        return step.hyperparameters.log_evidence < best - POLICY.clear

    problem = alone.about(structured.fit).problem()
    outcome, steps = iterate(
        problem,
        fits.max_iterations,
        alone.report,
        lambda step: is_coarse(step) or has_lost(step),
    )
    if not steps:
        return structured
    last = steps[-1]
    value = evidence_of_steps(problem, steps)
    gain = structured.log_evidence - value
    named = dataclasses.replace(structured, gain=gain)
    fits.trace.note((), "free kernels from the states of the terms", value)
    if gain > POLICY.decisive or (
        gain > -2 * POLICY.decisive and structured.stands_alone
    ):
        return named
    if outcome is Outcome.CONVERGED and not is_coarse(last):
        fit = evidence_fit(problem, outcome, steps, not_finite=NOT_FINITE, advice={})
        return StructuredFit(fit, gain)
    try:
        free = fit_free(alone, None if turns else rough)
    except FitError:
        return named
    if free.log_evidence < structured.log_evidence - POLICY.decisive:
        return named
    return free if free.structure else StructuredFit(free.fit, gain)
