r"""`discover`: which law is behind a learned force, and how well it is known.

Candidate laws are fitted to the learned force, weighted by the covariance of its
errors; the best of them are refitted through the equations of motion and ranked there.
"""

import enum
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.stats
from jaxtyping import Float

from pinav.analysis.candidates import GAUSSIAN, POTENTIALS, ROTATIONS
from pinav.analysis.field import (
    CentralTest,
    ForceSample,
    central_test,
    force_sample,
)
from pinav.analysis.laws import AbstractLaw, LawForce, Role, latex, sympy_text
from pinav.analysis.refit import Lifted, Refit, RefitOutcome, RefitProblem, refit
from pinav.analysis.regression import FieldFit, fit_law, fit_sum, fit_two_gaussians
from pinav.dynamics import Swimmer
from pinav.errors import FitError, InputError
from pinav.fitting import Posterior
from pinav.fitting.smoother import smoothed_states
from pinav.solvers import FixedStep
from pinav.trajectories import Trajectories

CLOSE = 6.0
"""Laws whose BIC is within this of the best are not told apart."""

MISFIT_PROBABILITY = 1e-3
"""A law fits if it leaves a misfit that chance makes more often than this."""


class EstimatedConstant(eqx.Module):
    """A constant of a law, as the trajectories determine it.

    Attributes:
        name: in words.
        symbol: in LaTeX.
        unit: dimension in length L and time T; "1" means dimensionless.
        value: best value.
        sd: standard deviation; infinite where the data say nothing.
        low: lower end of the 95 % interval.
        high: upper end.
        identifiable: whether the interval is short enough to mean anything.
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
        name: of the law.
        law: the formula.
        constants: their values and intervals.
        force: the law with these values.
        bic: Bayesian information criterion on the trajectories.
        delta_bic: that of this law less that of the best one.
        field_bic: the criterion on the learned force, by which the laws to be refitted
            were chosen.
        noise: standard deviation of the observations that the law needs.
        outcome: how the refit ended.
        fits: whether the law explains the data as well as the learned force does.
        latex: the formula in LaTeX.
        sympy: both components of the force as SymPy prints and parses them.
    """

    name: str
    law: AbstractLaw = eqx.field(static=True)
    constants: tuple[EstimatedConstant, ...]
    force: LawForce
    bic: float
    delta_bic: float
    field_bic: float
    noise: float
    outcome: RefitOutcome = eqx.field(static=True)
    fits: bool
    latex: str
    sympy: str


class Verdict(enum.Enum):
    """What a discovery says of the law."""

    IDENTIFIED = "identified"
    NOT_IDENTIFIABLE = "not identifiable"
    NO_LAW_FITS = "no law fits"


class Discovery(eqx.Module):
    """The laws that may be behind a learned force.

    Attributes:
        candidates: laws refitted on the trajectories, the best one first.
        screened: all laws by their criterion on the learned force, the best one first;
            pairs of a name and that criterion.
        verdict: identified, not identifiable (several laws are within `CLOSE` of the
            best one, or one of its constants is not determined), or no law fits.
        central: whether the force is central at all.
        learned_noise: standard deviation of the observations about the learned force.
        num_effective: independent numbers that the data tell about the force.
    """

    candidates: tuple[Candidate, ...]
    screened: tuple[tuple[str, float], ...] = eqx.field(static=True)
    verdict: Verdict = eqx.field(static=True)
    central: CentralTest
    learned_noise: float
    num_effective: float

    @property
    def best(self) -> Candidate:
        """The law of the lowest criterion."""
        return self.candidates[0]

    @property
    def close(self) -> tuple[Candidate, ...]:
        """The laws within `CLOSE` of the best one, itself included."""
        return tuple(c for c in self.candidates if c.delta_bic < CLOSE)


class Learned(eqx.Module):
    """A learned force held against the trajectories once more.

    Attributes:
        problem: the trajectories, linearised about the smoothed states.
        squares: sum of squared residuals.
        noise: standard deviation of the observations.
        num_effective: parameters that the data, not the prior, determine.
    """

    problem: RefitProblem
    squares: float
    noise: float
    num_effective: float

    @classmethod
    def of(
        cls, posterior: Posterior, trajectories: Trajectories, solver: FixedStep
    ) -> "Learned":
        """Linearise the mean model about states that fulfil its dynamics.

        Raises:
            FitError: no such states were found.
        """
        with jax.enable_x64(new_val=True):
            problem = RefitProblem.of(
                trajectories, smoothed_states(trajectories), solver
            )
            start = Lifted.at(posterior.free, posterior.mean, problem.states, problem)
            lifted = problem.closed(start)
            if not lifted.is_finite or problem.defect(lifted) > 1e-3:
                raise FitError(
                    "law discovery: the learned force does not explain the "
                    "trajectories; fit it to them first"
                )
            problem = eqx.tree_at(lambda p: p.states, problem, lifted.states)
            hessian = np.asarray(lifted.linear.hessian)
            squares, count = lifted.squares, problem.num_residuals
        # the noise and the number of parameters depend on each other
        information = np.sum(hessian * posterior.covariance)
        effective = min(float(len(posterior.mean)), 0.5 * count)
        for _ in range(50):
            noise = np.sqrt(max(squares, 1e-300) / max(count - effective, 1.0))
            ceiling = min(float(len(posterior.mean)), 0.5 * count)
            effective = float(np.clip(information / noise**2, 1.0, ceiling))
        return cls(problem, squares, float(noise), effective)

    def explained_by(self, law: Refit) -> bool:
        """Whether the misfit that a law adds is what chance may add."""
        if law.outcome is RefitOutcome.DIVERGED:
            return False
        excess = (law.squares - self.squares) / self.noise**2
        chance = scipy.stats.chi2.sf(max(excess, 0.0), max(self.num_effective, 1.0))
        return bool(chance > MISFIT_PROBABILITY)


def discover(
    posterior: Posterior,
    trajectories: Trajectories,
    *,
    potentials: Sequence[AbstractLaw] = POTENTIALS,
    rotations: Sequence[AbstractLaw] = ROTATIONS,
    refits: int = 5,
    solver: FixedStep | None = None,
) -> Discovery:
    """Rank candidate laws of a learned force, with intervals for their constants.

    A learned potential cannot show a rotational force: where there may be one, learn
    a free force.

    Args:
        posterior: of a fit, as `fit_bayes` returns it.
        trajectories: those that the model was fitted to; planar.
        potentials: conservative candidates.
        rotations: candidates without a potential, tried alone and beside the best
            potentials.
        refits: number of laws refitted through the equations of motion.
        solver: steps between samples; two substeps unless given.

    Raises:
        InputError: there are no candidates, `refits` is not positive, or the
            trajectories are not planar or too short.
        FitError: the learned force does not explain the trajectories.
    """
    if refits < 1 or not (potentials or rotations):
        raise InputError(
            "discover: expected one or more candidates and refits, got "
            f"{len(potentials) + len(rotations)} and {refits}"
        )
    solver = FixedStep(substeps=2) if solver is None else solver
    model = posterior.model
    if not isinstance(model, Swimmer):
        raise InputError(
            "discover posterior: expected that of a Swimmer with a learned "
            f"environment, got {type(model).__name__}"
        )
    learned = Learned.of(posterior, trajectories, solver)
    sample = force_sample(posterior, trajectories, learned.num_effective)
    screened = screen(sample, potentials, rotations)
    refitted = [
        refit(fit.law, fit.constants, model, learned.problem)
        for fit in screened[:refits]
    ]
    candidates = _ranked(screened, refitted, learned)
    return Discovery(
        candidates=candidates,
        screened=tuple((fit.law.name, fit.bic) for fit in screened),
        verdict=_verdict(candidates),
        central=central_test(sample),
        learned_noise=learned.noise,
        num_effective=learned.num_effective,
    )


def screen(
    sample: ForceSample,
    potentials: Sequence[AbstractLaw] = POTENTIALS,
    rotations: Sequence[AbstractLaw] = ROTATIONS,
) -> list[FieldFit]:
    """All candidates fitted to a sampled force, the lowest criterion first.

    Args:
        sample: the force, with the covariance of its errors.
        potentials: conservative candidates; where a Gaussian is among them, the sum of
            two is one as well.
        rotations: tried alone and beside the best three potentials.
    """
    conservative = [fit_law(law, sample) for law in potentials]
    single = [fit for fit in conservative if fit.law is GAUSSIAN]
    pairs = [fit_two_gaussians(fit, sample) for fit in single]
    leaders = sorted(conservative, key=lambda fit: fit.bic)[:3]
    alone = [fit_law(law, sample) for law in rotations]
    sums = [fit_sum(fit, law, sample) for fit in leaders for law in rotations]
    return sorted([*conservative, *pairs, *alone, *sums], key=lambda fit: fit.bic)


def _ranked(screened, refitted, learned):
    """Candidates in the order of their criterion on the trajectories."""
    least = min(result.bic for result in refitted)
    pairs = sorted(zip(screened, refitted, strict=False), key=lambda p: p[1].bic)
    return tuple(
        Candidate(
            name=result.law.name,
            law=result.law,
            constants=estimates(result, learned.problem.extent),
            force=LawForce(result.law, jnp.asarray(result.constants)),
            bic=result.bic,
            delta_bic=result.bic - least if np.isfinite(result.bic) else np.inf,
            field_bic=field.bic,
            noise=result.noise,
            outcome=result.outcome,
            fits=learned.explained_by(result),
            latex=latex(result.law),
            sympy=sympy_text(result.law, result.constants),
        )
        for field, result in pairs
    )


def _verdict(candidates):
    best = candidates[0]
    rivals = sum(candidate.delta_bic < CLOSE for candidate in candidates)
    if not best.fits:
        return Verdict.NO_LAW_FITS
    if rivals > 1 or not all(own.identifiable for own in best.constants):
        return Verdict.NOT_IDENTIFIABLE
    return Verdict.IDENTIFIED


def estimates(
    result: Refit, extent: float
) -> tuple[EstimatedConstant, ...]:
    """The constants of a refit with their 95 % intervals.

    A constant is not identifiable where its interval is wider than: zero to twice its
    value for amplitudes and scales, the extent of the data for positions, a right
    angle for angles.

    Args:
        result: of a law.
        extent: of the data [L].
    """
    sd = np.sqrt(np.diag(result.covariance))
    found = []
    for own, value, spread in zip(
        result.law.constants, result.constants, sd, strict=True
    ):
        reach = {Role.POSITION: 0.5 * extent, Role.ANGLE: 0.25 * np.pi}
        half = 1.96 * float(spread)
        found.append(
            EstimatedConstant(
                name=own.name,
                symbol=own.symbol,
                unit=own.unit,
                value=float(value),
                sd=float(spread),
                low=float(value) - half,
                high=float(value) + half,
                identifiable=bool(half < reach.get(own.role, abs(float(value)))),
            )
        )
    return tuple(found)
