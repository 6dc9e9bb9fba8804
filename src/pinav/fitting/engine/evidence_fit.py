"""Steps of a fit with the evidence, how they end, and the result of every such fit."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.errors import FitError
from pinav.fitting.engine.posterior import Estimate, Posterior
from pinav.fitting.engine.problem import AbstractProblem, Move, Step
from pinav.fitting.evidence.evidence import Hyperparameters
from pinav.fitting.evidence.model_evidence import LinearFit
from pinav.fitting.outcome import Outcome

DEFECT_TOLERANCE = 1e-4
"""Converged: defects relative to the states' spread."""

ROUNDING = 1e-9
"""Defects at which another step changes nothing but the last digits of the evidence."""


class EvidenceProgress(eqx.Module):
    """The state of a fit after a step, for a progress bar.

    Attributes:
        done: steps done, on the kernels as they are now.
        defect: by which the states miss the dynamics, relative to their spread.
        force: name of the force, where one fit tries several.
    """

    done: int
    total: int
    parameters: int
    defect: float
    noise: float
    log_evidence: float
    force: str = ""


PROBES = 2
"""Steps after which the evidence is asked whether the kernels are too coarse."""


def iterate(
    problem: AbstractProblem,
    max_iterations: int,
    on_step: Callable[[EvidenceProgress], None] | None = None,
    enough: Callable[[Step], bool] = lambda _: False,
    begun: Sequence[Step] = (),
) -> tuple[Outcome, list[Step]]:
    """Steps until they converge, diverge, run out, or are not worth going on with.

    Args:
        enough: whether another problem is better, after `PROBES` steps or more.
        begun: steps of an iteration that goes on.
    """
    move = Move(problem.theta, problem.states, problem.step_rule)
    chosen: Hyperparameters | None = None
    steps = list(begun)
    if steps:
        move, chosen = steps[-1].move, steps[-1].hyperparameters
    is_settled, is_moved = False, False
    while len(steps) < max_iterations:
        step = _attempt(problem, move, chosen)
        if step is None:
            return Outcome.DIVERGED, steps
        move, chosen = step.move, step.hyperparameters
        steps.append(step)
        if on_step:
            progress = EvidenceProgress(
                done=len(steps),
                total=max_iterations,
                parameters=len(step.covariance),
                defect=step.defect,
                noise=chosen.noise,
                log_evidence=chosen.log_evidence,
            )
            on_step(progress)
        # A defect is that of the point from which a step goes: under another prior the
        # step may be long, and only the next one tells whether it led anywhere.
        outcome = Outcome.STALLED if is_moved else _outcome(steps, problem.tolerance)
        is_moved = False
        if outcome is Outcome.CONVERGED and not is_settled:
            # Each search begins where the last one ended, so that the first
            # linearisations, which are rough, may have led to a lower maximum.
            is_settled = True
            likelier = step.weights.search_anew(step.quadratic, chosen, problem.noise)
            if likelier is not None:
                chosen, is_moved = likelier, True
                continue
        if outcome is not Outcome.STALLED:
            return outcome, steps
        if len(steps) >= PROBES and enough(step):
            return outcome, steps
    return Outcome.STALLED, steps


def _attempt(
    problem: AbstractProblem, move: Move, before: Hyperparameters | None
) -> Step | None:
    """One step; None where it leads nowhere, after others that did."""
    try:
        return problem.step(move, before)
    except FitError:
        if before is not None:
            return None
        raise


def _outcome(steps: list[Step], tolerance: float) -> Outcome:
    """Converged, or not yet; defects that grow without bound count as diverged."""
    last = steps[-1]
    if len(steps) > 1:
        before = steps[-2].hyperparameters.log_evidence
        change = abs(last.hyperparameters.log_evidence - before)
        # The evidence alone may stand still while the states do not yet obey the model.
        if change < tolerance and last.defect < DEFECT_TOLERANCE:
            return Outcome.CONVERGED
    if last.defect < ROUNDING:
        return Outcome.CONVERGED
    if last.defect > 100 * max(steps[0].defect, 1.0):
        return Outcome.DIVERGED
    return Outcome.STALLED


SIGNIFICANT = 4.0
"""Standard deviations of chance beyond which a statistic counts as a misfit."""


MOST_CORRELATED = 0.95
"""Correlation of neighbours beyond which residuals are no first-order process."""


class GoodnessOfFit(eqx.Module):
    r"""Two statistics of the residuals, divided by the standard deviation of the noise.

    The noise of a right model is independent, of variance one. A missing force
    correlates neighbours in time. Where the noise is estimated, $\chi^2$ is one by
    construction and only the correlation tells.

    Fitted numbers take some of the noise with them. Of the hat matrix $H$, with a
    trace of p, they leave neighbours a covariance of $-H_{t,t+1}$. A matrix with no
    negative eigenvalue has $|2 H_{t,t+1}| \le H_{tt} + H_{t+1,t+1}$, so that a right
    model may have a correlation down to $-p$ in the number of degrees of freedom.

    Attributes:
        reduced_chi2: sum of squares per degree of freedom.
        lag1: correlation of neighbours in time.
        num_fitted: p, residuals less degrees of freedom.
    """

    reduced_chi2: float
    lag1: float
    num_free: float
    num_fitted: float
    noise_known: bool

    @property
    def is_adequate(self) -> bool:
        """Whether chance explains both statistics."""
        chance = SIGNIFICANT / np.sqrt(self.num_free)
        least = -self.num_fitted / self.num_free - chance
        excess = (self.reduced_chi2 - 1) * np.sqrt(self.num_free / 2)
        too_large = self.noise_known and excess > SIGNIFICANT
        return bool(least <= self.lag1 <= chance and not too_large)

    @property
    def inflation(self) -> float:
        r"""Factor of the posterior covariance for residuals that neighbours share.

        $(1 + \rho)/(1 - \rho)$ of a first-order process with their correlation: as many
        times fewer data as there seem to be. One where chance explains it.
        """
        if self.lag1 <= SIGNIFICANT / np.sqrt(self.num_free):
            return 1.0
        correlation = min(self.lag1, MOST_CORRELATED)
        return (1 + correlation) / (1 - correlation)

    @property
    def statement(self) -> str:
        """One sentence for a terminal or a report."""
        numbers = f"lag-1 autocorrelation {self.lag1:+.2f}"
        if self.noise_known:
            numbers = f"reduced chi-squared {self.reduced_chi2:.2f}, {numbers}"
        if self.is_adequate:
            return f"Residuals are consistent with independent noise ({numbers})."
        return (
            f"Residuals are not independent noise ({numbers}): the known forces, the "
            "propulsion or the noise model are wrong, and the learned field and its "
            "bands are not to be trusted."
        )


def goodness_of_fit(
    series: list[Float[np.ndarray, "_ channel"]],
    noise: float,
    num_free: float,
    *,
    noise_known: bool,
) -> GoodnessOfFit:
    """Judge residuals.

    Args:
        series: residuals of each trajectory, in the order of time; NaN where nothing
            was observed.
        num_free: their number less the parameters that the data determine.
    """
    scale = max(noise, np.finfo(float).tiny)
    scaled = [np.asarray(residuals) / scale for residuals in series]
    squares = sum(float(np.nansum(r**2)) for r in scaled)
    # pairs with a gap between them are left out: how far apart they are varies
    pairs = sum(float(np.nansum(r[1:] * r[:-1])) for r in scaled)
    left, count = max(num_free, 1.0), sum(int(np.isfinite(r).sum()) for r in scaled)
    return GoodnessOfFit(
        reduced_chi2=squares / left,
        lag1=pairs / max(squares, np.finfo(float).tiny),
        num_free=left,
        num_fitted=max(count - left, 0.0),
        noise_known=noise_known,
    )


class EvidenceFit(eqx.Module):
    """A fitted model, and how well it is known.

    Attributes:
        outcome: how the fit ended; unless it converged, the rest is what was reached
            last.
        iterations: Gauss-Newton steps taken, on the last kernels.
        hyperparameters: noise, shape of the prior (empty where it has none), amplitude
            (0 without weights), and the log evidence.
        posterior: distribution of all learned parameters.
        constants: parameters with a flat prior by the path of their leaf, as
            `drag.damping`, and `diffusion` where the noise is thermal.
        states: the smoothed states, which fulfil the dynamics when converged; None
            where the residuals are not those of trajectories.
        linear: the linear problem in which the fit ended; see `model_evidence`.
        goodness: whether the residuals look like noise; None where they have no order
            in time.
        thermal: the `ThermalResult` of thermal motion; None of other fits.
    """

    model: Any
    outcome: Outcome = eqx.field(static=True)
    iterations: int = eqx.field(static=True)
    hyperparameters: Hyperparameters
    posterior: Posterior
    constants: dict[str, Estimate]
    states: Float[np.ndarray, "trajectory time state"] | None
    linear: LinearFit
    goodness: GoodnessOfFit | None = None
    thermal: Any = None


def evidence_fit(
    problem: AbstractProblem,
    outcome: Outcome,
    steps: list[Step],
    *,
    not_finite: str,
    advice: Mapping[Outcome, str],
) -> EvidenceFit:
    """The result of an iteration.

    Args:
        not_finite: what to say where there was no step at all.
        advice: what to raise for outcomes that do not count.
    """
    if not steps:
        raise FitError(f"the fit diverged at once: {not_finite}", str(outcome))
    if outcome in advice:
        raise FitError(advice[outcome], str(outcome))
    last = steps[-1]
    posterior, states = problem.posterior(last), last.move.states
    series, chosen = problem.residual_series(last), last.hyperparameters
    goodness = None
    if series is not None:
        num_free = last.quadratic.num_free - last.num_determined
        known = problem.noise is not None
        goodness = goodness_of_fit(series, chosen.noise, num_free, noise_known=known)
        covariance = goodness.inflation * posterior.covariance
        posterior = eqx.tree_at(lambda p: p.covariance, posterior, covariance)
    sd = np.sqrt(np.maximum(np.diag(posterior.covariance), 0.0))
    return EvidenceFit(
        model=posterior.model,
        outcome=outcome,
        iterations=len(steps),
        hyperparameters=chosen,
        posterior=posterior,
        constants={
            problem.names[i]: Estimate(float(posterior.mean[i]), float(sd[i]))
            for i in np.flatnonzero(problem.flat)
        },
        states=None if states is None else np.asarray(states),
        linear=problem.linear_fit(last),
        goodness=goodness,
    )
