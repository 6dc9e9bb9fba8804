r"""`fit_structured`: a free fit, and the structure that the evidence prefers to it.

The structure is sought first, because it costs seconds and spares the refinement of
kernels where it explains the data; then the free field is fitted, and the structured
one, each with its own engine run on the same data. The one of higher evidence is the
result. A structured force keeps free kernels beside its terms.
"""

import contextlib
import dataclasses
import operator
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np

from pinav.dynamics import FixedStep, Swimmer
from pinav.errors import FitError
from pinav.fitting.bayes.fit_bayes import ADVICE, NOT_FINITE
from pinav.fitting.bayes.neural import FitSpecification
from pinav.fitting.bayes.parameters import Learn
from pinav.fitting.bayes.problem import BayesProblem
from pinav.fitting.engine.evidence_fit import EvidenceFit, evidence_fit
from pinav.fitting.engine.iterate import EvidenceProgress, iterate
from pinav.fitting.engine.problem import Step
from pinav.fitting.environments.refinement import (
    AS_FINE_AS_ASKED,
    Refinement,
    iterate_refined,
)
from pinav.fitting.evidence.model_evidence import (
    DECISIVE,
    evidence_without_second,
    model_evidence,
)
from pinav.fitting.outcome import Outcome
from pinav.fitting.structure.proposals import Proposal, fallbacks, prune, refine
from pinav.fitting.structure.rotation import fitted_gain, mixture_on, survey_rotation
from pinav.fitting.structure.starts import GRID
from pinav.fitting.structure.survey import Survey
from pinav.fitting.structure.trials import Terms, polish
from pinav.forces import (
    AbstractForce,
    AbstractLearnedForce,
    StructuredForce,
    as_learned_force,
    forces_at,
    split_structure,
)
from pinav.numerics import free_programs
from pinav.trajectories import Trajectories, with_velocities

CLEAR = 100.0
"""Nats before the cost of hyperparameters by which a fit has lost to another, converged
or not."""

BEFORE_SURVEY = 3
"""Steps of the fit of a proposal, after which the data are asked for a better one."""

ABSENT = 0.02
"""Force of a term, relative to the greatest one, below which it may be needless."""

LEAST_TRAJECTORIES, LEAST_SAMPLES = 6, 600
"""Trajectories and observed numbers below which data are not worth a search."""


class StructuredFit(eqx.Module):
    """A fit, and what the search for structure came to.

    Attributes:
        fit: the result, structured or free.
        gain: log evidence of the structured force over the free one on the kernels with
            which fits begin [nats]; NaN where no structure was fitted.
        rotation: log evidence of a rotational part beside a potential [nats]: of the
            fit where it has one, of the data linearised before it where it has none;
            NaN where none was weighed.
    """

    fit: EvidenceFit
    gain: float
    rotation: float = np.nan

    @property
    def structure(self) -> StructuredForce | None:
        """The structured force, where one was preferred."""
        environment = self.fit.model.environment
        return environment if split_structure(environment)[0] else None


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
) -> StructuredFit:
    """Fit kernels, and a structured force where the data show one; see `fit_bayes`.

    Args:
        model: dynamics whose environment is a `KernelPotential`, a `KernelForce` or a
            `KernelMixture`.
        trajectories: what was observed.
        learn: constants to learn too.
        noise: standard deviation of the observations; estimated unless given.
        solver: steps between samples; `FixedStep()` unless given.
        max_iterations: after which a fit counts as stalled.
        on_step: called after each step.
        weigh_rotation: fit a `KernelMixture` in place of a `KernelPotential` where the
            evidence of planar data, however few, prefers a rotational part, or the
            potential alone diverges.
        throw: raise where the fit did not converge.

    Raises:
        FitError: as `fit_bayes` does.
    """
    free_programs()
    if isinstance(model, Swimmer):
        trajectories = with_velocities(trajectories)
    with jax.enable_x64(new_val=True):
        solver = FixedStep() if solver is None else solver
        specification = FitSpecification(model, trajectories, learn, noise, solver)
        search = _Search(specification, max_iterations, on_step, throw)
        weigh_rotation &= may_turn(model)
        if not is_worth_a_search(model, trajectories):
            return _weigh_few(search) if weigh_rotation else search.best(None)
        survey = Survey.of(specification, search.free())
        if weigh_rotation:
            return _weigh_rotation(search, survey)
        turning = not search.kernels.is_conservative
        return search.best(survey.proposal(rotational=turning))


def is_worth_a_search(model: Any, trajectories: Trajectories) -> bool:
    """Whether the data could tell a structure of a force that does not change."""
    return (
        _static_field(model) is not None
        and len(trajectories) >= LEAST_TRAJECTORIES
        and trajectories.num_observed >= LEAST_SAMPLES
    )


def may_turn(model: Any) -> bool:
    """Whether a rotational part can be weighed beside the potential of a model."""
    field = _static_field(model)
    return field is not None and field.is_conservative and field.dim == 2


def _static_field(model: Any) -> AbstractLearnedForce | None:
    """The force of a model where it is a field of kernels that does not change."""
    force = as_learned_force(model.environment)
    if force is None or force.kernels is None or force.dim not in GRID:
        return None
    return force if force.is_static else None


class _Search(eqx.Module):
    """Fits of one kind of free kernels, with structured terms and without.

    Attributes:
        specification: what is asked; its model is that of the free kernels.
        max_iterations: of each fit.
        on_step: called after each step.
        throw: raise where a fit did not converge.
    """

    specification: FitSpecification
    max_iterations: int
    on_step: Callable[[EvidenceProgress], None] | None
    throw: bool

    @property
    def kernels(self) -> Any:
        return self.specification.model.environment

    def of(self, environment: AbstractForce) -> "_Search":
        """The same with other free kernels."""
        model = eqx.tree_at(
            lambda m: m.environment, self.specification.model, environment
        )
        return eqx.tree_at(lambda s: s.specification.model, self, model)

    def free(self) -> BayesProblem:
        return self.specification.problem(self.specification.model)

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

    def best(self, proposal: Proposal | None) -> StructuredFit:
        """The free fit or that of a proposed structure, by their evidence.

        The free fit begins where the other ended, and ends early where it cannot win.
        """
        proposed = None if proposal is None else self._fit_proposal(proposal)
        if proposed is None:
            return StructuredFit(self.fit(self.free(), AS_FINE_AS_ASKED), np.nan)
        structured, evidence = proposed
        model, best = self.specification.model, structured.hyperparameters.log_evidence

        def is_coarse(step: Step) -> bool:
            shape = step.hyperparameters.shape
            return AS_FINE_AS_ASKED.is_needed(model.environment, shape)

        def has_lost(step: Step) -> bool:
            return step.hyperparameters.log_evidence < best - CLEAR

        free = self.specification.problem(model, states=structured.states)
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
        if gain > DECISIVE:
            return StructuredFit(structured, gain)
        if outcome is Outcome.CONVERGED and not is_coarse(last):
            alone = evidence_fit(free, outcome, steps, not_finite=NOT_FINITE, advice={})
            return StructuredFit(alone, gain)
        return StructuredFit(self.fit(self.free(), AS_FINE_AS_ASKED), gain)

    def _fit_proposal(self, proposal: Proposal) -> tuple[EvidenceFit, float] | None:
        """The fit of proposed terms beside the free kernels; None where it fails.

        The terms explain data linearised about smoothed states, whose errors needless
        terms may explain. So their fit is interrupted after a few steps, and about it
        the data are asked again what is needed. Where no fit carries all terms, as
        about a centre that swimmers circle faster than smoothing follows, the one that
        was added last is left out; of obstacles, which such errors multiply, one stays.

        Returns:
            The fit, and its log evidence.
        """
        fit: EvidenceFit | None = None
        with contextlib.suppress(FitError):
            fit = self._fit_in_two_stages(proposal)
            if fit is None or fit.outcome is Outcome.CONVERGED:
                return fit and (fit, _evidence(fit))
        best = None
        if fit is not None and fit.outcome is not Outcome.DIVERGED:
            best = fit, _evidence(fit)
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
        begun = self._begin(proposal.terms)
        if begun.outcome is Outcome.DIVERGED:
            return begun
        terms = begun.model.environment.terms
        survey = Survey.of(self.specification, self.free(), begun)
        whole = polish(terms, survey.response)
        other = whole and prune(refine(whole, survey.response), survey.response)
        if proposal.is_rough and not (other and survey.is_near_noise(other)):
            return None
        if other is not None and other is not whole:
            fit = self._fit_terms(other.terms, begun)
            if _is_as_good(fit, begun):
                return self._without_absent(fit)
        return self._without_absent(self._fit_terms(terms, begun))

    def _without_absent(self, fit: EvidenceFit) -> EvidenceFit:
        """The fit without terms that it left next to nothing to do.

        About the first steps, which are rough, they may have seemed needed. Where the
        free remainder does something it may have taken their place, and they stay.
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
        is_worse = _evidence(fewer) < _evidence(fit) - DECISIVE
        return fit if fewer.outcome is Outcome.DIVERGED or is_worse else fewer

    def _begin(self, terms: Terms) -> EvidenceFit:
        """The first steps of the fit of terms beside the free kernels."""
        search = self.of(StructuredForce(terms, self.kernels))
        problem = search.free()
        how = iterate(problem, BEFORE_SURVEY, search.report)
        return evidence_fit(problem, *how, not_finite=NOT_FINITE, advice={})

    def _fit_terms(self, terms: Terms, begun: EvidenceFit) -> EvidenceFit:
        """The fit of terms beside the free kernels, from the states of another."""
        search = self.of(StructuredForce(terms, self.kernels))
        specification = search.specification
        problem = specification.problem(specification.model, states=begun.states)
        return search.fit(problem, None)


def _relative_forces(fit: EvidenceFit) -> list[float]:
    """Of each term of a fit, and of the remainder: its force, relative to the greatest.

    Forces are those at the samples.
    """
    states, force = np.asarray(fit.states), fit.model.environment
    places = states[..., : force.dim].reshape(-1, force.dim)
    times = np.zeros(len(places))
    parts = (*force.terms, force.remainder)
    sizes = [float(np.std(forces_at(part, times, places))) for part in parts]
    return [size / max(*sizes, np.finfo(float).tiny) for size in sizes]


def _is_as_good(fit: EvidenceFit, begun: EvidenceFit) -> bool:
    """Whether a fit of other terms explains the data nearly as well as one that began.

    The evidence about states that have not converged is too rough for more.
    """
    lost = begun.hyperparameters.log_evidence - fit.hyperparameters.log_evidence
    return fit.outcome is not Outcome.DIVERGED and lost < CLEAR


def _evidence(fit: EvidenceFit) -> float:
    """Log evidence of a fit; of terms also where the free kernels are absent."""
    whole = model_evidence(fit.linear, fit.hyperparameters).log_evidence
    if not split_structure(fit.model.environment)[0]:
        return whole
    return max(whole, evidence_without_second(fit.linear, fit.hyperparameters))


def _weigh_rotation(search: _Search, survey: Survey) -> StructuredFit:
    """The fit of a potential or that of a mixture, by the evidence of its rotation."""
    kernels = search.kernels.kernels
    asked = survey_rotation(survey.response, survey.noise, (), kernels)
    turning, rotation = None, asked.gain
    proposal, turned = survey.proposal(rotational=False), None
    is_open = _unless_rough(proposal) is None
    if rotation > DECISIVE and is_open:
        turned = _unless_rough(survey.proposal(rotational=True))
    if is_open and (asked.is_plain or turned is not None):
        turning = _turning(search, turned)
        if turning is not None and turning.rotation > DECISIVE:
            return turning
        rotation = np.nan if turning is None else turning.rotation
    still, is_potential = _potential(
        search,
        proposal,
        lambda: _turning(search, turned) if turning is None else turning,
    )
    if not is_potential:
        return still
    if not rotation > DECISIVE:  # which may be NaN
        return StructuredFit(still.fit, still.gain, rotation)
    return _weigh_beside(search, still, proposal if turned is None else turned)


def _unless_rough(proposal: Proposal | None) -> Proposal | None:
    """A proposal that explains the data nearly to the noise, or None."""
    return None if proposal is None or proposal.is_rough else proposal


def _potential(
    search: _Search,
    proposal: Proposal | None,
    mixture: Callable[[], StructuredFit | None],
) -> tuple[StructuredFit, bool]:
    """The fit of a potential, or where that fails one of a mixture; which of them.

    Args:
        search: of the potential.
        proposal: terms beside it.
        mixture: gives the other fit, or None where that fails, too.

    Raises:
        FitError: both failed; the error is that of the potential.
    """
    try:
        still = search.best(proposal)
    except FitError:
        turning = mixture()
        if turning is None:
            raise
        return turning, False
    if still.fit.outcome is Outcome.DIVERGED:
        return mixture() or still, False
    return still, True


def _weigh_few(search: _Search) -> StructuredFit:
    """The fit of a potential or that of a mixture, of data too few for a search.

    A potential that is refined may follow a few trajectories whatever the force is, so
    that nothing linearised about it asks for more. A mixture on the kernels with which
    fits begin costs little and, where the force turns, needs no finer ones to explain
    the data better.
    """
    still, is_potential = _potential(search, None, lambda: _turning(search, None))
    if not is_potential:
        return still
    rotation = _coarse_rotation(search, still.fit)
    turning = _turning(search, None) if rotation > DECISIVE else None
    if turning is None:
        return StructuredFit(still.fit, still.gain, rotation)
    rotation = _evidence(turning.fit) - _evidence(still.fit)
    chosen = turning if rotation > DECISIVE else still
    return StructuredFit(chosen.fit, chosen.gain, rotation)


def _coarse_rotation(search: _Search, still: EvidenceFit) -> float:
    """Log evidence of a mixture that is not refined over a potential that is [nats]."""
    mixture = search.of(mixture_on(search.kernels.kernels))
    try:
        fit = mixture.fit(mixture.free(), None)
    except FitError:
        return np.nan
    is_bad = fit.outcome is Outcome.DIVERGED
    return np.nan if is_bad else _evidence(fit) - _evidence(still)


def _weigh_beside(
    search: _Search, still: StructuredFit, proposal: Proposal | None
) -> StructuredFit:
    """The fit of a potential, or that of a mixture where the data about it ask for one.

    Args:
        search: of the potential.
        still: its fit.
        proposal: terms beside which a mixture is fitted.
    """
    rotation, turning = _rotation_beside(search, still.fit), None
    if rotation > DECISIVE:
        turning = _turning(search, proposal)
        rotation = np.nan if turning is None else turning.rotation
    if turning is not None and rotation > DECISIVE:
        return turning
    return StructuredFit(still.fit, still.gain, rotation)


def _rotation_beside(search: _Search, fit: EvidenceFit) -> float:
    """Log evidence of a rotational part in the data linearised about a potential."""
    force = fit.model.environment
    terms, _ = split_structure(force)
    about = Survey.of(search.specification, search.free(), fit)
    return survey_rotation(about.response, about.noise, terms, force.kernels).gain


def _turning(search: _Search, proposal: Proposal | None) -> StructuredFit | None:
    """The fit of a mixture, beside a structure or alone; None where it fails."""
    try:
        mixture = search.of(mixture_on(search.kernels.kernels)).best(proposal)
    except FitError:
        return None
    if mixture.fit.outcome is Outcome.DIVERGED:
        return None
    return StructuredFit(mixture.fit, mixture.gain, fitted_gain(mixture.fit))
