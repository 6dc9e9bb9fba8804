"""Laws fitted to a sampled force, and the choice of those that are refitted.

Where the force has a structure, each of its terms is asked for its law, and the best
laws of the terms are combined. Where it has none, laws are added one after the other
as long as the sum leaves more than the errors of the force.
"""

import itertools
from collections.abc import Sequence
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
import scipy.special
from jaxtyping import Array, ArrayLike, Float

from pinav.analysis.discovery.force_sample import ForceSample
from pinav.analysis.discovery.term_laws import MOST_TERMS, TermLaws
from pinav.forces import forces_at
from pinav.forces.formulas import Role
from pinav.forces.law_force import LawForce
from pinav.forces.laws import AbstractLaw, terms_of
from pinav.forces.priors import Points
from pinav.threads import map_on_cores

STARTS = 3
"""Best starts from which a fit is run to its end."""

Values = Float[np.ndarray, " constant"]
"""Values of the constants of a law, in their order."""

Bounds = tuple[Values, Values]
"""Least and greatest value of each constant."""


class FieldFit(eqx.Module):
    """A law fitted to a sampled force.

    Attributes:
        bic: the squares, plus log of the effective sample size for each constant.
    """

    law: AbstractLaw = eqx.field(static=True)
    constants: Values
    squares: float
    bic: float


def fit_law(
    law: AbstractLaw,
    sample: ForceSample,
    starts: Float[np.ndarray, "start constant"] | None = None,
) -> FieldFit:
    """Weighted nonlinear least squares from the best of several starts.

    Args:
        starts: constants to start from, whatever their amplitudes; those that the
            force itself suggests unless given.
    """
    if starts is None:
        starts = np.array(law.shapes(sample.landscape), float)
    with jax.enable_x64(new_val=True):
        problem = _Regression(law, sample.positions, sample.force, sample.whitener)
        low, high = _bounds(law, sample)
        scaled = [problem.with_best_amplitudes(np.clip(s, low, high)) for s in starts]
        scaled = [np.clip(start, low, high) for start in scaled]
        costs = [float(np.sum(problem.evaluate(start)[0] ** 2)) for start in scaled]
        fits = [problem.fit(scaled[i], (low, high)) for i in np.argsort(costs)[:STARTS]]
    best = min(fits, key=lambda fit: fit.cost)
    squares = 2 * float(best.cost)
    penalty = len(law.constants) * np.log(max(sample.num_effective, np.e))
    return FieldFit(law, best.x, squares, squares + float(penalty))


def fit_sum(first: FieldFit, term: AbstractLaw, sample: ForceSample) -> FieldFit:
    """A fitted law plus a term, which starts from the force that the law leaves."""
    rest = sample.less(law_force(first.law, first.constants, sample.positions))
    second = fit_law(term, rest)
    start = np.concatenate([first.constants, second.constants])
    return fit_law(first.law + term, sample, start[None])


def law_force(law: AbstractLaw, constants: Values, positions: Points) -> Points:
    """The force of a law at points [L T⁻²]."""
    with jax.enable_x64(new_val=True):
        force = LawForce(law, jnp.asarray(constants))
        return np.asarray(forces_at(force, np.zeros(len(positions)), positions))


@eqx.filter_jit
def _force_and_slopes(
    law: AbstractLaw,
    constants: Float[ArrayLike, " constant"],
    positions: Float[ArrayLike, "point dim"],
) -> tuple[Float[Array, "point dim"], Float[Array, "point dim constant"]]:
    """One program for both: compiling a second one takes longer than all its calls."""

    def force(constants: Float[Array, " constant"]) -> tuple[Array, Array]:
        times = np.zeros(np.shape(positions)[:1])
        values = forces_at(LawForce(law, constants), times, positions)
        return values, values

    slopes, values = jax.jacfwd(force, has_aux=True)(jnp.asarray(constants))
    return values, slopes


class _Regression(eqx.Module):
    """Whitened residuals of a law, as a function of its constants."""

    law: AbstractLaw = eqx.field(static=True)
    positions: Points
    force: Points
    whitener: Float[np.ndarray, "component component"]

    def evaluate(
        self, constants: Values
    ) -> tuple[
        Float[np.ndarray, " component"], Float[np.ndarray, "component constant"]
    ]:
        """Residuals and their derivatives.

        Those of a sum are found term by term, whose programs are there already.
        """
        both = [
            _force_and_slopes(law, np.asarray(c), self.positions)
            for law, c in self.law.split(tuple(constants))
        ]
        missed = sum(np.asarray(force) for force, _ in both) - self.force
        slopes = np.concatenate([np.asarray(slope) for _, slope in both], axis=-1)
        columns = slopes.reshape(-1, len(constants))
        return self.whitener @ missed.reshape(-1), self.whitener @ columns

    def with_best_amplitudes(self, constants: Values) -> Values:
        """The constants with the amplitudes, which are linear, at their best."""
        chosen = self.law.indices(Role.AMPLITUDE)
        values = np.array(constants, float)
        values[chosen] = 0.0
        rest, columns = self.evaluate(values)
        values[chosen] = np.linalg.lstsq(columns[:, chosen], -rest, rcond=1e-10)[0]
        return values

    def fit(self, start: Values, bounds: Bounds) -> scipy.optimize.OptimizeResult:
        return scipy.optimize.least_squares(
            lambda constants: self.evaluate(constants)[0],
            start,
            cast(Any, lambda constants: self.evaluate(constants)[1]),
            bounds=bounds,
            x_scale="jac",
            max_nfev=200,
        )


def _bounds(law: AbstractLaw, sample: ForceSample) -> Bounds:
    """Bounds of each constant: wide, but with finite numbers throughout."""
    low, high = sample.positions.min(axis=0), sample.positions.max(axis=0)
    reach, middle = 5 * sample.extent, (low + high) / 2
    corner = float(np.abs(middle).max())
    limits = []
    for constant in law.constants:
        if constant.role is Role.SCALE:
            unit = sample.extent if constant.unit == "L" else 1.0
            limits.append((5e-3 * unit, 50 * unit))
        elif constant.role is Role.POSITION:
            limits.append((-corner - reach, corner + reach))
        else:
            limits.append((-np.inf, np.inf))
    low, high = np.array(limits).T
    return low, high


COMBINED = {1: 20, 2: 5, 3: 3}
"""Laws of each term that are combined, by the number of terms."""

LEADERS = 3
"""Laws, or sums, to which a term is added."""

MISFIT_PROBABILITY = 1e-3
"""A law explains a sampled force if chance leaves more as often as this."""


def screen(sample: ForceSample, laws: Sequence[AbstractLaw]) -> list[FieldFit]:
    """Laws and sums of up to three fitted to a force, the lowest criterion first."""
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

    Laws that are added one by one begin as a compromise between terms. Once the others
    are there, the right law explains as much with fewer constants.
    """
    made: list[FieldFit] = []
    for _ in terms_of(fit.law):
        first, *rest = terms_of(fit.law)
        if not rest:
            break
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
    """Sums of a law for each term, fitted to a force; the lowest criterion first."""

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
    """True if a law leaves no more of a force than its errors are."""
    free = max(sample.force.size - len(fit.constants), 1)
    return bool(scipy.special.chdtrc(free, fit.squares) > MISFIT_PROBABILITY)
