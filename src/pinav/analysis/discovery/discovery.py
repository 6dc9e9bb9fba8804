r"""`discover_law`: which law is behind a learned force, and how well it is known.

Candidate laws are fitted to the learned force, weighted by the covariance of its
errors; the best of them are refitted through the equations of motion and ranked there.
"""

import enum
from collections.abc import Mapping, Sequence

import equinox as eqx
import numpy as np

from pinav.analysis.discovery.candidates import LIBRARY
from pinav.analysis.discovery.force_sample import (
    CentralTest,
    ForceSample,
    Sampling,
    central_test,
)
from pinav.analysis.discovery.law_regression import (
    FieldFit,
    Values,
    law_force,
    screen,
    screen_terms,
)
from pinav.analysis.discovery.refit import (
    LearnedOnPaths,
    Refit,
    laplace_posterior,
    refit,
)
from pinav.analysis.discovery.term_laws import term_laws
from pinav.arguments import on_device
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.evaluation import normal_quantile
from pinav.fitting import AbstractLearned, Outcome, Posterior
from pinav.fitting.environments.summary import learned_part
from pinav.forces import as_learned_force, split_structure
from pinav.forces.formulas import Role
from pinav.forces.law_force import LawForce
from pinav.forces.laws import AbstractLaw, SumLaw, latex, sympy_text, terms_of
from pinav.forces.priors import Points
from pinav.identification import needs_kalman_filter
from pinav.trajectories import Trajectories, with_velocities
from pinav.units import model_unit, with_order

CLOSE = 6.0
"""Laws whose BIC is within this of the best are not told apart."""


class EstimatedConstant(eqx.Module):
    """A constant of a law, as the trajectories determine it.

    Attributes:
        unit: "1" means dimensionless.
        sd: standard deviation; infinite where the data say nothing.
        identifiable: True if the interval is short enough to mean anything.
    """

    name: str
    symbol: str
    unit: str
    value: float
    sd: float
    low: float
    high: float
    identifiable: bool


class Candidate(eqx.Module):
    """A law in the ranking.

    Attributes:
        bic: Bayesian information criterion on the trajectories.
        field_bic: the criterion on the learned force, by which the laws to be refitted
            were chosen.
        noise: standard deviation of the observations that the law needs.
        fits: True if the law explains the data as well as the learned force does.
        extends_best: True if the best law is a special case of this one, which then
            explains as much with more constants, and is no rival of it.
        sympy: both components of the force as SymPy prints and parses them.
    """

    name: str
    law: AbstractLaw = eqx.field(static=True)
    constants: tuple[EstimatedConstant, ...]
    bic: float
    delta_bic: float
    field_bic: float
    noise: float
    outcome: Outcome = eqx.field(static=True)
    fits: bool
    extends_best: bool
    latex: str
    sympy: str

    @property
    def values(self) -> Values:
        """The values of its constants, in their order."""
        return np.array([constant.value for constant in self.constants])

    @property
    def force(self) -> LawForce:
        """The law with these values."""
        return LawForce(self.law, on_device(self.values))

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the laws that it is the sum of."""
        return tuple(term.name for term in terms_of(self.law))


class Verdict(enum.Enum):
    """Verdict of a discovery."""

    IDENTIFIED = "identified"
    NOT_IDENTIFIABLE = "not identifiable"
    NO_LAW_FITS = "no law fits"


class Discovery(eqx.Module):
    """Ranked laws that may explain a learned force.

    Attributes:
        candidates: laws refitted on the trajectories, the best one first.
        screened: all laws by their criterion on the learned force, the best one first;
            pairs of a name and that criterion.
        verdict: identified, not identifiable (other laws are within `CLOSE` of the
            best one, or one of its constants is not determined), or no law fits.
        learned_noise: standard deviation of the observations about the learned force.
        num_effective: independent numbers that the data tell about the force.
        best_force: of the best law at the points of the sample [L T⁻²].
        structure: kinds of the terms whose laws were sought; none where the laws are
            those of the whole force.
    """

    candidates: tuple[Candidate, ...]
    screened: tuple[tuple[str, float], ...] = eqx.field(static=True)
    verdict: Verdict = eqx.field(static=True)
    central: CentralTest
    learned_noise: float
    num_effective: float
    sample: ForceSample
    best_force: Points
    structure: tuple[str, ...] = eqx.field(static=True, default=())
    units: dict[str, str] = eqx.field(default_factory=dict)

    @property
    def best(self) -> Candidate:
        """The law of the lowest criterion."""
        return self.candidates[0]

    @property
    def close(self) -> tuple[Candidate, ...]:
        """The laws not told apart from the best one, itself included."""
        return rivals(self.candidates)


def discover(fit: AbstractLearned, *, refits: int = 5) -> Discovery:
    """Rank the laws of the learned force of a fit.

    Args:
        fit: of a planar force, without thermal noise, commands or wandering velocity.
        refits: number of laws refitted through the equations of motion.

    Raises:
        InputError: the fit is none of a force.
        FitError: the learned force does not explain the trajectories.
    """
    return discover_law(_posterior(fit), fit.data, refits=refits, units=fit.units)


def _posterior(fit: AbstractLearned) -> Posterior:
    """The posterior of the fit, or one by Laplace about its model."""
    model = fit.model
    known = isinstance(model, Swimmer | OverdampedSwimmer)
    stochastic = fit.system.thermal_energy is not None or "diffusion" in fit.constants
    if not known or stochastic or needs_kalman_filter(fit.system):
        raise InputError(
            "discover: laws are refitted to trajectories that follow from their "
            "starts; expected a swimmer without thermal noise, commands or wandering "
            f"velocity, got the model {fit.choice.name} of system {fit.system.name}"
        )
    if as_learned_force(model.environment) is None:
        raise InputError(
            "discover: the model has no learned force of the environment; fit a kernel "
            "or neural model"
        )
    if fit.posterior is not None:
        return fit.posterior
    return laplace_posterior(model, fit.data, learned_part)


def discover_law(
    posterior: Posterior,
    trajectories: Trajectories,
    *,
    laws: Sequence[AbstractLaw] | None = None,
    refits: int = 5,
    units: Mapping[str, str] | None = None,
) -> Discovery:
    """Rank candidate laws of a learned force, with intervals for their constants.

    Where the fit has found a structure, each of its terms is asked for its law, and the
    laws of the terms are combined; else laws and sums of up to three are tried on the
    whole force. A learned potential cannot show a rotational force: where there may be
    one, learn a free force.

    Args:
        laws: candidates for the whole force in place of those of the library.
        refits: number of laws refitted through the equations of motion.
        units: of the channels, and the order (`pinav.units.with_order`); without them,
            those of the trajectories, and forces in no unit of their own.

    Raises:
        InputError: there are no candidates, `refits` is not positive, or the
            trajectories are not planar or too short.
        FitError: the learned force does not explain the trajectories.
    """
    library = LIBRARY if laws is None else laws
    if refits < 1 or not library:
        raise InputError(
            "discover_law: expected one or more candidates and refits, got "
            f"{len(library)} and {refits}"
        )
    model = posterior.model
    if not isinstance(model, Swimmer | OverdampedSwimmer):
        raise InputError(
            "discover_law posterior: expected that of a swimmer with a learned "
            f"environment, got {type(model).__name__}"
        )
    if isinstance(model, Swimmer):
        trajectories = with_velocities(trajectories)
    learned = LearnedOnPaths.of(posterior, trajectories)
    sampling = Sampling.of(posterior, trajectories, learned.num_effective)
    sample = sampling.sample(lambda force: force)
    structure, _ = split_structure(model.environment)
    terms = None if laws is not None else term_laws(structure, sampling)
    screened = screen(sample, library) if terms is None else screen_terms(terms, sample)
    refitted = _refit_best(screened, model, learned, refits)
    order = 2 if isinstance(model, Swimmer) else 1
    units = units or with_order(trajectories.units, order)
    candidates = _rank(refitted, learned, units)
    best = candidates[0]
    return Discovery(
        candidates=candidates,
        screened=tuple((fit.law.name, fit.bic) for fit in screened),
        verdict=_verdict(candidates),
        central=central_test(sample),
        learned_noise=learned.noise,
        num_effective=learned.num_effective,
        sample=sample,
        best_force=law_force(best.law, best.values, sample.positions),
        units=dict(units),
        structure=() if terms is None else tuple(term.kind for term in terms),
    )


def _refit_best(
    screened: list[FieldFit],
    model: Swimmer | OverdampedSwimmer,
    learned: LearnedOnPaths,
    refits: int,
) -> list[tuple[FieldFit, Refit]]:
    """The most promising laws, refitted; sums first where they gained on their terms.

    Where none of them explains the data, the best sums that were left out come too.
    """
    alone = {fit.law: fit.bic for fit in screened}

    def gains(fit: FieldFit) -> bool:
        terms = fit.law.terms if isinstance(fit.law, SumLaw) else ()
        return all(fit.bic < alone.get(term, np.inf) for term in terms)

    def refit_each(fits: list[FieldFit]) -> list[tuple[FieldFit, Refit]]:
        # Not on several cores: the batched factorisations of two predictions at a time
        # can wait for each other in XLA's pool of threads for ever.
        return [(fit, refit(fit.law, fit.constants, model, learned)) for fit in fits]

    chosen = [fit for fit in screened if gains(fit)][:refits]
    results = refit_each(chosen)
    if not any(learned.is_explained_by(result) for _, result in results):
        rest = [f for f in screened if isinstance(f.law, SumLaw) and f not in chosen]
        results += refit_each(rest[:3])
    return results


def _rank(
    refitted: list[tuple[FieldFit, Refit]],
    learned: LearnedOnPaths,
    units: Mapping[str, str],
) -> tuple[Candidate, ...]:
    pairs = sorted(refitted, key=lambda pair: pair[1].bic)
    best, least = pairs[0][1].law, pairs[0][1].bic
    return tuple(
        Candidate(
            name=result.law.name,
            law=result.law,
            constants=estimates(result, learned.extent, units),
            bic=result.bic,
            delta_bic=result.bic - least if np.isfinite(result.bic) else np.inf,
            field_bic=field.bic,
            noise=result.noise,
            outcome=result.outcome,
            fits=learned.is_explained_by(result),
            extends_best=result.law.contains(best),
            latex=latex(result.law),
            sympy=sympy_text(result.law, result.constants),
        )
        for field, result in pairs
    )


def rivals(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Laws within `CLOSE` of the best one that are not extensions of it."""
    return tuple(c for c in candidates if c.delta_bic < CLOSE and not c.extends_best)


def _verdict(candidates: tuple[Candidate, ...]) -> Verdict:
    best = candidates[0]
    if not best.fits:
        return Verdict.NO_LAW_FITS
    is_known = all(constant.identifiable for constant in best.constants)
    is_alone = len(rivals(candidates)) <= 1
    return Verdict.IDENTIFIED if is_known and is_alone else Verdict.NOT_IDENTIFIABLE


def estimates(
    result: Refit, extent: float, units: Mapping[str, str]
) -> tuple[EstimatedConstant, ...]:
    """The constants of a refit with their 95 % intervals.

    A constant is not identifiable where its interval is wider than: zero to twice its
    value for amplitudes and scales, the extent of the data for positions, a right
    angle for angles.

    Args:
        extent: of the data [L].
        units: of the channels, and the order.
    """
    sd = np.sqrt(np.diag(result.covariance))
    estimated = []
    for constant, value, spread in zip(
        result.law.constants, result.constants, sd, strict=True
    ):
        reach = {Role.POSITION: 0.5 * extent, Role.ANGLE: 0.25 * np.pi}
        half = normal_quantile() * float(spread)
        estimated.append(
            EstimatedConstant(
                name=constant.name,
                symbol=constant.symbol,
                unit=model_unit(constant.unit, units),
                value=float(value),
                sd=float(spread),
                low=float(value) - half,
                high=float(value) + half,
                identifiable=bool(half < reach.get(constant.role, abs(float(value)))),
            )
        )
    return tuple(estimated)
