"""Fits of free kernels and of a proposed structure, and which of them is the better.

The structure is fitted first, because it spares the refinement of kernels where it
explains the data; then the free field, each with its own engine run on the same data.
The one of higher evidence is the result. A structured force keeps free kernels beside
its terms.
"""

import contextlib
import dataclasses
import operator
from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np

from pinav.arguments import on_device
from pinav.errors import FitError
from pinav.fitting.bayes.fit_bayes import ADVICE, CLEAR, NOT_FINITE
from pinav.fitting.bayes.neural import FitSpecification
from pinav.fitting.bayes.problem import BayesProblem, States
from pinav.fitting.engine.evidence_fit import (
    EvidenceFit,
    EvidenceProgress,
    evidence_fit,
    iterate,
)
from pinav.fitting.engine.problem import Step
from pinav.fitting.environments.refinement import (
    AS_FINE_AS_ASKED,
    Refinement,
    iterate_refined,
)
from pinav.fitting.evidence.evidence import LinearisedObservations
from pinav.fitting.evidence.model_evidence import (
    DECISIVE,
    evidence_without_second,
    model_evidence,
)
from pinav.fitting.outcome import Outcome
from pinav.fitting.structure.hills import obstacles_of, propose_hills
from pinav.fitting.structure.laws import LAWFUL, follow_laws
from pinav.fitting.structure.proposals import fallbacks, prune, refine
from pinav.fitting.structure.survey import AT_NOISE, Survey, is_worth_a_search
from pinav.fitting.structure.trials import Proposal, Terms, polish
from pinav.forces import (
    AbstractForce,
    HillsTerm,
    ObstaclesTerm,
    StructuredForce,
    forces_at,
    split_structure,
)

TIED = 2 * DECISIVE
"""Nats by which terms that need nothing beside them may lose to free kernels. Kernels
whose envelope is the hill are as good a model of it, and have fewer numbers."""

BEFORE_SURVEY = 3
"""Steps of a fit, free or of a proposal, about which the data are asked for terms."""

AS_FINE_AS_HILLS_NEED = Refinement(max_weights=1000)
"""Kernels on which the places of hills are seen, if there are hills."""

ABSENT = 0.02
"""Force of a term, relative to the greatest one, below which it may be needless."""


class StructuredFit(eqx.Module):
    """A fit, and what the search for structure came to.

    Attributes:
        gain: log evidence of the structured force over the free one on the kernels with
            which fits begin, of hills over that on finer ones [nats]; NaN where no
            structure was fitted.
        rotation: log evidence of a rotational part beside a potential [nats]: of the
            fit where it has one, of the data linearised before it where it has none;
            NaN where none was weighed.
        teacher: of a network: the fit from which it was distilled, to which `gain` and
            `rotation` belong; None of kernels.
    """

    fit: EvidenceFit
    gain: float
    rotation: float = np.nan
    teacher: EvidenceFit | None = None

    @property
    def structure(self) -> StructuredForce | None:
        """The structured force, where one was preferred; of a network, its teacher."""
        fit = self.fit if self.teacher is None else self.teacher
        force: Any = fit.model.environment
        return force if split_structure(force)[0] else None

    @property
    def force(self) -> AbstractForce:
        """The learned force."""
        return self.fit.model.environment


class Search(eqx.Module):
    """Fits of free kernels with structured terms and without, begun at `states`."""

    specification: FitSpecification
    max_iterations: int
    on_step: Callable[[EvidenceProgress], None] | None
    throw: bool
    states: States | None = None

    @property
    def kernels(self) -> Any:
        return self.specification.model.environment

    def of(self, environment: AbstractForce) -> "Search":
        """The same with other free kernels."""
        model = eqx.tree_at(
            lambda m: m.environment, self.specification.model, environment
        )
        return eqx.tree_at(lambda s: s.specification.model, self, model)

    def free(self) -> BayesProblem:
        model, states = self.specification.model, self.states
        return self.specification.problem(model, states=states)

    def begin(self) -> EvidenceFit:
        """The first steps of the fit of what is free."""
        problem = self.free()
        how = iterate(problem, BEFORE_SURVEY, self.report)
        return evidence_fit(problem, *how, not_finite=NOT_FINITE, advice={})

    def about(self, fit: EvidenceFit) -> "Search":
        """The same from the states of a fit."""
        states = None if fit.states is None else on_device(fit.states)
        return dataclasses.replace(self, states=states)

    def report(self, progress: EvidenceProgress) -> None:
        """Pass a step on, with the name of the force."""
        if self.on_step is not None:
            named = dataclasses.replace(progress, force=self.kernels.kind)
            self.on_step(named)

    def fit(self, problem: BayesProblem, refine: Refinement | None) -> EvidenceFit:
        """A fit, begun anew on finer kernels where it asks for them."""
        how = iterate_refined(
            problem,
            self.specification.problem,
            refine,
            self.specification.trajectories,
            self.max_iterations,
            self.report,
        )
        advice = ADVICE if self.throw else {}
        return evidence_fit(*how, not_finite=NOT_FINITE, advice=advice)

    def best(
        self,
        proposal: Proposal | None,
        fit_free: Callable[[], StructuredFit] | None = None,
    ) -> StructuredFit:
        """The free fit or that of a proposed structure, by their evidence.

        The free fit begins where the other ended, and ends early where it cannot win.
        Where the evidence cannot tell, terms that need nothing beside them are
        preferred: they are simpler, and say more where there are no data.
        """
        fit_free = self.fit_free if fit_free is None else fit_free
        proposed = None if proposal is None else self._fit_proposal(proposal)
        if proposed is None:
            return fit_free()
        structured, evidence = self._with_laws(*proposed)
        model, best = self.specification.model, structured.hyperparameters.log_evidence

        def is_coarse(step: Step) -> bool:
            shape = step.hyperparameters.shape
            return AS_FINE_AS_ASKED.is_needed(model.environment, shape)

        def has_lost(step: Step) -> bool:
            return step.hyperparameters.log_evidence < best - CLEAR

        free = self.about(structured).free()
        outcome, steps = iterate(
            free,
            self.max_iterations,
            self.report,
            lambda step: is_coarse(step) or has_lost(step),
        )
        if not steps:
            return StructuredFit(structured, np.nan)
        last = steps[-1]
        linear, chosen = free.linear_fit(last), last.hyperparameters
        gain = evidence - model_evidence(linear, chosen).log_evidence
        if gain > DECISIVE or (gain > -TIED and stands_alone(structured)):
            return StructuredFit(structured, gain)
        if outcome is Outcome.CONVERGED and not is_coarse(last):
            alone = evidence_fit(free, outcome, steps, not_finite=NOT_FINITE, advice={})
            return StructuredFit(alone, gain)
        alone = fit_free()
        return alone if alone.structure else StructuredFit(alone.fit, gain)

    def fit_free(self) -> StructuredFit:
        """The fit of kernels as fine as the evidence asks for, or of hills.

        Detail finer than the first kernels may be in a few places: hills and wells
        beside coarse kernels are then simpler and quicker. They must win clearly, since
        their evidence is not charged for places that the data chose.
        """
        quiet = dataclasses.replace(self, throw=False)
        rough = quiet.fit(self.free(), AS_FINE_AS_HILLS_NEED)
        kernels = rough.model.environment
        if float(kernels.kernels.width) < float(self.kernels.kernels.width):
            hills = quiet._fit_hills(rough)
            if hills is not None and hills.gain > CLEAR:
                return hills
            finer = AS_FINE_AS_ASKED.finer(kernels, self.specification.trajectories)
            if rough.outcome is Outcome.UNDER_RESOLVED and finer is not None:
                finest = quiet.of(finer).about(rough)
                fit = finest.fit(finest.free(), AS_FINE_AS_ASKED)
                rough = rough if fit.outcome is Outcome.DIVERGED else fit
        if self.throw and rough.outcome in ADVICE:
            raise FitError(ADVICE[rough.outcome], str(rough.outcome))
        return StructuredFit(rough, np.nan)

    def _fit_hills(self, rough: EvidenceFit) -> StructuredFit | None:
        """The fit of hills about that of free kernels; None where there are none."""
        specification, potential = self.specification, rough.model.environment
        if not (
            is_worth_a_search(specification.model, specification.trajectories)
            and potential.is_conservative
            and potential.dim == 2
            and rough.outcome in (Outcome.CONVERGED, Outcome.UNDER_RESOLVED)
        ):
            return None
        survey = Survey.of(specification, self.free(), rough)
        chosen = rough.hyperparameters
        hills = propose_hills(survey.response, survey.noise, potential, chosen)
        if hills is None:
            return None
        try:
            fit = self._fit_terms((hills,), rough)
        except FitError:
            return None
        if fit.outcome is not Outcome.CONVERGED:
            return None
        gain = evidence_of(fit) - evidence_of(rough)
        return self._fit_obstacles(fit, rough) or StructuredFit(fit, gain)

    def _fit_obstacles(
        self, hills: EvidenceFit, rough: EvidenceFit
    ) -> StructuredFit | None:
        """The fit of obstacles of one kind in place of hills that are alike."""
        terms = hills.model.environment.terms
        survey = Survey.of(self.specification, self.free(), hills)
        alike = obstacles_of(terms[0], survey.region)
        if alike is None:
            return None
        # The fit of hills is not charged for their places; these proposals are.
        several = polish(terms, survey.response)
        proposal = polish((alike,), survey.response)
        if several is None or proposal is None:
            return None
        if several.log_evidence > proposal.log_evidence + DECISIVE:
            return None
        fit = self.about(hills)._fit_proposal(proposal)
        if fit is None or not _is_as_good(fit[0], hills):
            return None
        obstacles, evidence = self._with_laws(*fit)
        return StructuredFit(obstacles, evidence - evidence_of(rough))

    def _fit_proposal(self, proposal: Proposal) -> tuple[EvidenceFit, float] | None:
        """The fit of proposed terms beside the free kernels; None where it fails.

        The terms explain data linearised about states that have not converged, whose
        errors needless terms may explain. So their fit is interrupted after a few
        steps, and about it the data are asked again what is needed. Where no fit
        carries all terms, as about a centre that swimmers circle faster than smoothing
        follows, the one that was added last is left out; of obstacles, which such
        errors multiply, one stays.
        """
        fit: EvidenceFit | None = None
        with contextlib.suppress(FitError):
            fit = self._fit_in_two_stages(proposal)
            if fit is None or fit.outcome is Outcome.CONVERGED:
                return fit and (fit, evidence_of(fit))
        best = None
        if fit is not None and fit.outcome is not Outcome.DIVERGED:
            best = fit, evidence_of(fit)
        for fewer in fallbacks(proposal.terms):
            rough = dataclasses.replace(proposal, terms=fewer, is_rough=True)
            other = self._fit_proposal(rough)
            if other is not None:
                return max(best or other, other, key=operator.itemgetter(1))
        return best

    def _fit_in_two_stages(self, proposal: Proposal) -> EvidenceFit | None:
        """The fit of the terms that prove needed in a first one; it may have diverged.

        None where the terms do not explain the data about their own fit.
        """
        begun = self._beside(proposal.terms).begin()
        if begun.outcome is Outcome.DIVERGED:
            return begun
        terms = begun.model.environment.terms
        survey = Survey.of(self.specification, self.free(), begun)
        whole = polish(terms, survey.response)
        other = whole and prune(refine(whole, survey.response), survey.response)
        if not (other and survey.is_at_noise(other)):
            lawful = other and self._fit_laws_early(other, survey, begun)
            if lawful is not None:
                return self._without_absent(lawful)
            # States that miss the path misplace terms; those of these steps do not.
            again = None
            if not survey.would_repeat(proposal, whole):
                turns = not self.kernels.is_conservative
                again = survey.proposal(rotational=turns, enough=AT_NOISE)
            if again is not None and not again.is_rough:
                other = again
            elif proposal.is_rough and not (other and survey.is_near_noise(other)):
                return None
        if other is not None and other is not whole:
            fit = self._fit_terms(other.terms, begun)
            if _is_as_good(fit, begun):
                return self._without_absent(fit)
        return self._without_absent(self._fit_terms(terms, begun))

    def _fit_laws_early(
        self, proposal: Proposal, survey: Survey, begun: EvidenceFit
    ) -> EvidenceFit | None:
        """The fit of terms that follow laws, where those are all that is needed.

        About a centre the force of kernels vanishes; that of a wide ring does not, and
        other terms would be sought to make up for it.
        """
        if not survey.is_near_noise(proposal):
            return None
        lawful = follow_laws(proposal.terms, survey.response, proposal.noise)
        if lawful is None:
            return None
        fit = self._fit_terms(lawful.terms, begun)
        is_good = fit.hyperparameters.noise <= LAWFUL * survey.noise
        is_whole = fit.outcome is Outcome.CONVERGED and stands_alone(fit)
        return fit if is_good and is_whole else None

    def _without_absent(self, fit: EvidenceFit) -> EvidenceFit:
        """The fit without terms whose force is negligible.

        They may have seemed needed about the rough first steps. They stay if the free
        remainder is not negligible, since it may have taken their place.
        """
        if fit.outcome is Outcome.DIVERGED:
            return fit
        terms = fit.model.environment.terms
        *shares, rest = _relative_forces(fit)
        kept = tuple(
            term for term, share in zip(terms, shares, strict=True) if share > ABSENT
        )
        if rest > ABSENT or len(kept) == len(terms):
            return fit
        fewer = self._fit_terms(kept, fit)
        is_worse = evidence_of(fewer) < evidence_of(fit) - DECISIVE
        return fit if fewer.outcome is Outcome.DIVERGED or is_worse else fewer

    def _with_laws(
        self, fit: EvidenceFit, evidence: float
    ) -> tuple[EvidenceFit, float]:
        survey = Survey.of(self.specification, self.free(), fit)
        noise = fit.hyperparameters.noise
        lawful = follow_laws(fit.model.environment.terms, survey.response, noise)
        if lawful is None:
            return fit, evidence
        with contextlib.suppress(FitError):
            other = self._fit_terms(lawful.terms, fit)
            gained = evidence_of(other)
            if other.outcome is Outcome.CONVERGED and gained > evidence - DECISIVE:
                return other, gained
        return fit, evidence

    def _fit_terms(self, terms: Terms, begun: EvidenceFit) -> EvidenceFit:
        search = self._beside(terms).about(begun)
        return search.fit(search.free(), None)

    def _beside(self, terms: Terms) -> "Search":
        return self.of(StructuredForce(terms, self.kernels))


def needs_no_search(force: AbstractForce) -> bool:
    """True if a rugged force is so well known that no other structure is sought.

    Namely obstacles of one kind or many separate hills. A few hills may be a sum of
    other terms, and overlapping ones parts of a ring or of a wall.
    """
    terms, _ = split_structure(force)
    return any(
        isinstance(term, ObstaclesTerm)
        or (isinstance(term, HillsTerm) and np.sum(term.gaps > SEPARATE) >= MANY)
        for term in terms
    )


MANY, SEPARATE = 9, 1.5
"""Hills of a rugged field, of which fewer may be a sum or obstacles of one kind; and
the distance of each from the others, in its own sizes."""


def _relative_forces(fit: EvidenceFit) -> list[float]:
    """Force of each term and the remainder at the samples, over the greatest."""
    states, force = np.asarray(fit.states), fit.model.environment
    places = states[..., : force.dim].reshape(-1, force.dim)
    times = np.zeros(len(places))
    parts = (*force.terms, force.remainder)
    sizes = [float(np.std(forces_at(part, times, places))) for part in parts]
    return [size / max(*sizes, np.finfo(float).tiny) for size in sizes]


def _is_as_good(fit: EvidenceFit, begun: EvidenceFit) -> bool:
    """True if a fit of other terms explains the data nearly as well as one that began.

    The evidence about states that have not converged is too rough for more.
    """
    lost = begun.hyperparameters.log_evidence - fit.hyperparameters.log_evidence
    return fit.outcome is not Outcome.DIVERGED and lost < CLEAR


def evidence_of(fit: EvidenceFit) -> float:
    """Log evidence of a fit; of terms also where the free kernels are absent."""
    whole = model_evidence(fit.linear, fit.hyperparameters).log_evidence
    return max(whole, _evidence_of_terms(fit))


def stands_alone(fit: EvidenceFit) -> bool:
    """True if terms explain the data without free kernels, and no force does not."""
    whole = model_evidence(fit.linear, fit.hyperparameters).log_evidence
    nothing = LinearisedObservations.of(fit.linear.quadratic).log_evidence_without
    is_a_force = fit.hyperparameters.log_evidence > nothing + CLEAR
    return is_a_force and _evidence_of_terms(fit) > whole - DECISIVE


def _evidence_of_terms(fit: EvidenceFit) -> float:
    if not split_structure(fit.model.environment)[0]:
        return -np.inf
    return evidence_without_second(fit.linear, fit.hyperparameters)
