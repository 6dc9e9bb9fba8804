"""`fit_structured`: the structure that the evidence prefers; whether a force turns.

Where the data are worth it the structure is sought first (`Search`); in a plane it is
also asked whether a mixture, which may turn, explains more than a potential. A network
learns from the fit of kernels that this gives.
"""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np

from pinav.dynamics import FixedStep, Swimmer
from pinav.errors import FitError
from pinav.fitting.bayes.fit_bayes import fit_bayes
from pinav.fitting.bayes.neural import FitSpecification
from pinav.fitting.bayes.parameters import Learn
from pinav.fitting.engine.evidence_fit import EvidenceFit, EvidenceProgress
from pinav.fitting.environments.refinement import AS_FINE_AS_ASKED
from pinav.fitting.evidence.model_evidence import DECISIVE
from pinav.fitting.outcome import Outcome
from pinav.fitting.structure.candidates import EXPLAINED
from pinav.fitting.structure.search import (
    Search,
    StructuredFit,
    evidence_of,
    needs_no_search,
)
from pinav.fitting.structure.survey import (
    Survey,
    fitted_gain,
    is_network,
    is_worth_a_search,
    may_turn,
    mixture_on,
    survey_rotation,
)
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
            return _fit_student(specification, max_iterations, on_step, throw=throw)
        search = Search(specification, max_iterations, on_step, throw)
        weigh_rotation &= may_turn(model)
        if not is_worth_a_search(model, trajectories):
            return _weigh_few(search) if weigh_rotation else search.best(None)
        search, survey, is_rugged = survey_first_steps(search)
        fit_free = functools.cache(search.fit_free)
        if weigh_rotation:
            return _weigh_rotation(search, survey, fit_free, is_rugged=is_rugged)
        is_still = search.kernels.is_conservative
        if is_rugged and is_still and survey.is_hopeless(rotational=False):
            if needs_no_search(fit_free().force):
                return fit_free()
            if _explains(fit_free().fit, survey):
                search, survey = _about(search, fit_free().fit)
        return search.best(survey.proposal(rotational=not is_still), fit_free)


def _fit_student(
    specification: FitSpecification,
    max_iterations: int,
    on_step: Callable[[EvidenceProgress], None] | None,
    *,
    throw: bool,
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
        return StructuredFit(learning(), np.nan)
    kernels, weigh_rotation = kernels_of_teacher(specification)
    pupil = eqx.tree_at(lambda m: m.environment, model, kernels)
    teach = functools.partial(fit_structured, pupil, data, **learning.keywords)
    try:
        taught = teach(throw=False, weigh_rotation=weigh_rotation)
    except FitError:  # as of a potential, where the force turns
        return StructuredFit(learning(), np.nan)
    if taught.fit.outcome is Outcome.DIVERGED:
        return StructuredFit(learning(), np.nan)
    fit = learning(teacher=taught.fit)
    return StructuredFit(fit, taught.gain, taught.rotation, taught.fit)


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


def survey_first_steps(search: Search) -> tuple[Search, Survey, bool]:
    """A survey about the first steps of the free fit, and the search from there.

    Smoothed states miss the path of quick swimmers, so that data linearised about them
    suggest spurious forces. They are kept where free kernels do not explain the data,
    as a potential cannot those of a swirl.
    """
    specification, smooth = search.specification, search.free()
    survey = Survey.of(specification, smooth)
    try:
        begun = search.begin()
    except FitError:
        return search, survey, False
    is_bad, chosen = begun.outcome is Outcome.DIVERGED, begun.hyperparameters
    if is_bad or chosen.noise > EXPLAINED * survey.noise:
        kernels = search.kernels
        return search, survey, AS_FINE_AS_ASKED.is_needed(kernels, chosen.shape)
    return *_about(search, begun), False


def _explains(free: EvidenceFit, survey: Survey) -> bool:
    """True if the fit of free kernels explains the data nearly to the noise."""
    is_good = free.outcome in (Outcome.CONVERGED, Outcome.UNDER_RESOLVED)
    return is_good and free.hyperparameters.noise <= EXPLAINED * survey.noise


def _about(search: Search, fit: EvidenceFit) -> tuple[Search, Survey]:
    search = search.about(fit)
    return search, Survey.of(search.specification, search.free(), fit)


def _weigh_rotation(
    search: Search,
    survey: Survey,
    fit_free: Callable[[], StructuredFit],
    *,
    is_rugged: bool,
) -> StructuredFit:
    """The fit of a potential or that of a mixture, by the evidence of its rotation."""
    kernels = search.kernels.kernels
    asked = survey_rotation(survey.response, survey.noise, (), kernels)
    is_plain = asked.is_plain
    if is_rugged and not is_plain and survey.is_hopeless(rotational=False):
        is_plain = asked.is_needed and not survey.is_hopeless(rotational=True)
        if not is_plain:
            free = fit_free()
            if needs_no_search(free.force):
                return _weigh_beside(search, free, None)
            if _explains(free.fit, survey):
                search, survey = _about(search, free.fit)
                kernels = free.fit.model.environment.kernels
                asked = survey_rotation(survey.response, survey.noise, (), kernels)
                is_plain = asked.is_plain
    turning, turned, rotation = None, None, asked.gain
    potential = functools.cache(lambda: survey.proposal(rotational=False))

    def no_potential_explains() -> bool:
        # About smoothed states a rough one may be right; its fit will tell.
        best = potential()
        return best is None or (best.is_rough and survey.is_begun)

    # Where a rotation is plain a search for a potential would take long, for nothing.
    if is_plain or (asked.is_needed and no_potential_explains()):
        turned = _unless_rough(survey.proposal(rotational=True))
    if _has_swirl(turned) or (
        no_potential_explains() and (is_plain or turned is not None)
    ):
        turning = _turning(search, turned)
        if turning is not None and turning.rotation > DECISIVE:
            return turning
        rotation = np.nan if turning is None else turning.rotation
    still, is_potential = _potential(
        search,
        potential(),
        lambda: _turning(search, turned) if turning is None else turning,
        fit_free,
    )
    if not is_potential:
        return still
    if not rotation > DECISIVE:  # which may be NaN
        return StructuredFit(still.fit, still.gain, rotation)
    return _weigh_beside(search, still, potential() if turned is None else turned)


def _has_swirl(proposal: Proposal | None) -> bool:
    return proposal is not None and any(term.rotational for term in proposal.terms)


def _unless_rough(proposal: Proposal | None) -> Proposal | None:
    """A proposal that explains the data nearly to the noise, or None."""
    return None if proposal is None or proposal.is_rough else proposal


def _potential(
    search: Search,
    proposal: Proposal | None,
    mixture: Callable[[], StructuredFit | None],
    fit_free: Callable[[], StructuredFit] | None = None,
) -> tuple[StructuredFit, bool]:
    """The fit of a potential, or where that fails one of a mixture; which of them."""
    try:
        still = search.best(proposal, fit_free)
    except FitError:
        turning = mixture()
        if turning is None:
            raise
        return turning, False
    if still.fit.outcome is Outcome.DIVERGED:
        return mixture() or still, False
    return still, True


def _weigh_few(search: Search) -> StructuredFit:
    """The fit of a potential or of a mixture, to data too few for a search.

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
    rotation = evidence_of(turning.fit) - evidence_of(still.fit)
    chosen = turning if rotation > DECISIVE else still
    return StructuredFit(chosen.fit, chosen.gain, rotation)


def _coarse_rotation(search: Search, still: EvidenceFit) -> float:
    """Log evidence of a mixture that is not refined over a potential that is [nats]."""
    mixture = search.of(mixture_on(search.kernels.kernels))
    try:
        fit = mixture.fit(mixture.free(), None)
    except FitError:
        return np.nan
    is_bad = fit.outcome is Outcome.DIVERGED
    return np.nan if is_bad else evidence_of(fit) - evidence_of(still)


def _weigh_beside(
    search: Search, still: StructuredFit, proposal: Proposal | None
) -> StructuredFit:
    """The fit of a potential, or of a mixture where the data about it ask for one."""
    rotation, turning = _rotation_beside(search, still.fit), None
    if rotation > DECISIVE:
        turning = _turning(search, proposal)
        rotation = np.nan if turning is None else turning.rotation
    if turning is not None and rotation > DECISIVE:
        is_better = not needs_no_search(still.force) or (
            evidence_of(turning.fit) > evidence_of(still.fit)
        )
        return turning if is_better else still
    return StructuredFit(still.fit, still.gain, rotation)


def _rotation_beside(search: Search, fit: EvidenceFit) -> float:
    """Log evidence of a rotational part in the data linearised about a potential."""
    force = fit.model.environment
    terms, _ = split_structure(force)
    about = Survey.of(search.specification, search.free(), fit)
    return survey_rotation(about.response, about.noise, terms, force.kernels).gain


def _turning(search: Search, proposal: Proposal | None) -> StructuredFit | None:
    try:
        mixture = search.of(mixture_on(search.kernels.kernels)).best(proposal)
    except FitError:
        return None
    if mixture.fit.outcome is Outcome.DIVERGED:
        return None
    return StructuredFit(mixture.fit, mixture.gain, fitted_gain(mixture.fit))
