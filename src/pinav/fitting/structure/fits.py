"""Engine fits of free kernels, with terms and without, and their evidence."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np

from pinav.arguments import on_device
from pinav.errors import FitError
from pinav.fitting.bayes.fit_bayes import ADVICE, NOT_FINITE
from pinav.fitting.bayes.neural import FitSpecification
from pinav.fitting.bayes.problem import BayesProblem, States
from pinav.fitting.engine.evidence_fit import (
    EvidenceFit,
    EvidenceProgress,
    evidence_fit,
    iterate,
)
from pinav.fitting.environments.refinement import Refinement, iterate_refined
from pinav.fitting.evidence.evidence import LinearisedObservations
from pinav.fitting.evidence.model_evidence import (
    evidence_without_second,
    model_evidence,
)
from pinav.fitting.outcome import Outcome
from pinav.fitting.policy import POLICY
from pinav.fitting.structure.rotation import mixture_on
from pinav.fitting.structure.trace import Hypothesis, Trace
from pinav.fitting.structure.trials import Terms
from pinav.forces import AbstractForce, StructuredForce, split_structure
from pinav.trajectories import Trajectories


class StructuredFit(eqx.Module):
    """A fit, and what the search for structure came to.

    Attributes:
        gain: log evidence of the structured force over the free one on the kernels with
            which fits begin, of hills over that on finer ones [nats]; NaN where no
            structure was fitted.
        rotation: log evidence of a rotational part beside a potential [nats]: of the
            fit where it has one, of the data linearised about it where it has none;
            NaN where none was weighed.
        teacher: of a network: the fit from which it was distilled, to which `gain` and
            `rotation` belong; None of kernels.
        trace: hypotheses that were weighed, in their order.
    """

    fit: EvidenceFit
    gain: float = np.nan
    rotation: float = np.nan
    teacher: EvidenceFit | None = None
    trace: tuple[Hypothesis, ...] = ()

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

    @functools.cached_property
    def log_evidence(self) -> float:
        """Log evidence [nats], of terms also where the free kernels are absent."""
        return max(_evidence_of_all(self.fit), _evidence_of_terms(self.fit))

    @property
    def stands_alone(self) -> bool:
        """True if terms alone explain the data, and no force at all does not."""
        fit = self.fit
        nothing = LinearisedObservations.of(fit.linear.quadratic).log_evidence_without
        is_a_force = fit.hyperparameters.log_evidence > nothing + POLICY.clear
        alone = _evidence_of_terms(fit)
        return is_a_force and alone > _evidence_of_all(fit) - POLICY.decisive


class Fits(eqx.Module):
    """Fits of the same data with one kind of free kernels, begun at `states`.

    Attributes:
        throw: raise a FitError where free kernels alone do not converge.
        trace: of the search to which the fits belong.
    """

    specification: FitSpecification
    max_iterations: int
    on_step: Callable[[EvidenceProgress], None] | None
    throw: bool
    trace: Trace = eqx.field(static=True)
    states: States | None = None

    @property
    def kernels(self) -> Any:
        """The environment: free kernels, beside terms if there are any."""
        return self.specification.model.environment

    def of(self, environment: AbstractForce) -> "Fits":
        """The same with another environment."""
        model = eqx.tree_at(
            lambda m: m.environment, self.specification.model, environment
        )
        return eqx.tree_at(lambda s: s.specification.model, self, model)

    def beside(self, terms: Terms) -> "Fits":
        """The same with terms beside the kernels, which turn where a term does."""
        turns = any(term.rotational for term in terms)
        free = self.turning() if turns and self.kernels.is_conservative else self
        return free.of(StructuredForce(terms, free.kernels)) if terms else free

    def turning(self) -> "Fits":
        """The same with kernels that may turn, on the same places."""
        return self.of(mixture_on(self.kernels.kernels))

    def about(self, fit: EvidenceFit) -> "Fits":
        """The same from the states of a fit."""
        states = None if fit.states is None else on_device(fit.states)
        return dataclasses.replace(self, states=states)

    def to(self, data: Trajectories) -> "Fits":
        """Fits of other data, from their smoothed states."""
        specification = dataclasses.replace(self.specification, trajectories=data)
        return dataclasses.replace(self, specification=specification, states=None)

    def problem(self) -> BayesProblem:
        """The problem of the environment from the states."""
        model, states = self.specification.model, self.states
        return self.specification.problem(model, states=states)

    def begin(self) -> EvidenceFit | None:
        """The first steps of a fit; None where they diverge."""
        problem = self.problem()
        try:
            how = iterate(problem, POLICY.first_steps, self.report)
            fit = evidence_fit(problem, *how, not_finite=NOT_FINITE, advice={})
        except FitError:
            return None
        return None if fit.outcome is Outcome.DIVERGED else fit

    def fit(self, refine: Refinement | None = None) -> EvidenceFit:
        """A fit, begun anew on finer kernels where `refine` asks for them.

        Raises:
            FitError: it fails; where `throw`, it does not converge.
        """
        how = iterate_refined(
            self.problem(),
            self.specification.problem,
            refine,
            self.specification.trajectories,
            self.max_iterations,
            self.report,
        )
        advice = ADVICE if self.throw else {}
        return evidence_fit(*how, not_finite=NOT_FINITE, advice=advice)

    def try_terms(
        self, terms: Terms, begun: EvidenceFit | None = None
    ) -> StructuredFit | None:
        """The fit of terms beside the kernels; None where it diverges.

        Args:
            begun: a fit from whose states it begins.
        """
        first = self if begun is None else self.about(begun)
        quiet = dataclasses.replace(first.beside(terms), throw=False)
        try:
            tried = StructuredFit(quiet.fit())
        except FitError:
            tried = None
        if tried is None or tried.fit.outcome is Outcome.DIVERGED:
            self.trace.note(terms, "its fit diverged")
            return None
        self.trace.note(terms, f"its fit {tried.fit.outcome}", tried.log_evidence)
        return tried

    def report(self, progress: EvidenceProgress) -> None:
        """Pass a step on, with the name of the force."""
        if self.on_step is not None:
            self.on_step(dataclasses.replace(progress, force=self.kernels.kind))


def _evidence_of_all(fit: EvidenceFit) -> float:
    return model_evidence(fit.linear, fit.hyperparameters).log_evidence


def _evidence_of_terms(fit: EvidenceFit) -> float:
    if not split_structure(fit.model.environment)[0]:
        return -np.inf
    return evidence_without_second(fit.linear, fit.hyperparameters)
