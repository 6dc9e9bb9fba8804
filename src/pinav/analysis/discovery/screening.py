"""Candidate laws by how well they explain a learned force: which ones to refit.

Where the force has a structure, each of its terms is asked for its law, and the best
laws of the terms are combined. Where it has none, laws are added one after the other
as long as the sum leaves more than the errors of the force.
"""

import itertools
from collections.abc import Sequence

import numpy as np
import scipy.special

from pinav.analysis.discovery.force_sample import ForceSample
from pinav.analysis.discovery.law_regression import (
    FieldFit,
    fit_law,
    fit_sum,
)
from pinav.analysis.discovery.laws import AbstractLaw, SumLaw, terms_of
from pinav.analysis.discovery.term_laws import MOST_TERMS, TermLaws
from pinav.threads import map_on_cores

COMBINED = {1: 20, 2: 5, 3: 3}
"""Laws of each term that are combined, by the number of terms."""

LEADERS = 3
"""Laws, or sums, to which a term is added."""

MISFIT_PROBABILITY = 1e-3
"""A law explains a sampled force if chance leaves more as often as this."""


def screen(sample: ForceSample, laws: Sequence[AbstractLaw]) -> list[FieldFit]:
    """Laws and sums of up to three fitted to a force, the lowest criterion first.

    Args:
        sample: the force, with the covariance of its errors.
        laws: candidates.
    """
    fits = map_on_cores(lambda law: fit_law(law, sample), list(laws))
    everything = list(fits)
    for _ in range(MOST_TERMS - 1):
        fits = sorted(fits, key=lambda fit: fit.bic)[:LEADERS]
        if any(is_explained(fit, sample) for fit in everything):
            break
        both = [(fit, law) for fit in fits for law in laws]
        fits = map_on_cores(lambda pair: fit_sum(*pair, sample), both)
        everything += fits
    best = min(everything, key=lambda fit: fit.bic)
    everything += exchange_terms(best, laws, sample)
    ranking = sorted(everything, key=lambda fit: fit.bic, reverse=True)
    # of sums of the same terms in another order the best one stays
    distinct = {
        tuple(sorted(term.name for term in terms_of(fit.law))): fit for fit in ranking
    }
    return sorted(distinct.values(), key=lambda fit: fit.bic)


def exchange_terms(
    fit: FieldFit, laws: Sequence[AbstractLaw], sample: ForceSample
) -> list[FieldFit]:
    """Sums in which each term in turn is left out or exchanged for any law.

    Laws that are added one after the other begin with a compromise between terms, whose
    formula need not be that of any of them. Once the others are there, the right one
    explains as much with fewer constants.

    Args:
        fit: of a sum; a single law has no term to exchange.
        laws: candidates.
        sample: the force.

    Returns:
        The sums that were tried.
    """
    made: list[FieldFit] = []
    count = len(fit.law.terms) if isinstance(fit.law, SumLaw) else 0
    for _ in range(count):
        if not isinstance(fit.law, SumLaw):
            break
        first, *rest = fit.law.terms
        kept = sum(rest[1:], rest[0])
        others = fit_law(kept, sample, fit.constants[None, len(first.constants) :])
        begun = FieldFit(kept, fit.constants[len(first.constants) :], np.inf, np.inf)
        pairs = [(begun, law) for law in dict.fromkeys([first, *laws])]
        tries = [others, *map_on_cores(lambda pair: fit_sum(*pair, sample), pairs)]
        # the exchanged term now stands last, and the next one first
        fit = min(tries, key=lambda one: one.bic)
        made += tries
    return made


def screen_terms(terms: Sequence[TermLaws], sample: ForceSample) -> list[FieldFit]:
    """Sums of a law for each term, fitted to a force; the lowest criterion first.

    Args:
        terms: of the force, each with its candidates.
        sample: the whole force, with the covariance of its errors.
    """

    def rank(term: TermLaws) -> list[FieldFit]:
        def fit(law: AbstractLaw) -> FieldFit:
            starts = np.array(law.shapes(term.landscape), float)
            return fit_law(law, term.sample, starts)

        fits = map_on_cores(fit, list(term.laws))
        return sorted(fits, key=lambda fit: fit.bic)[: COMBINED[len(terms)]]

    def combine(fits: Sequence[FieldFit]) -> FieldFit:
        first, *others = (fit.law for fit in fits)
        law = sum(others, first)
        start = np.concatenate([fit.constants for fit in fits])
        return fit_law(law, sample, start[None])

    chosen = itertools.product(*(rank(term) for term in terms))
    return sorted(map_on_cores(combine, list(chosen)), key=lambda fit: fit.bic)


def is_explained(fit: FieldFit, sample: ForceSample) -> bool:
    """Whether a law leaves no more of a force than its errors are."""
    free = max(sample.force.size - len(fit.constants), 1)
    return bool(scipy.special.chdtrc(free, fit.squares) > MISFIT_PROBABILITY)
