"""The result of every fit by the evidence, and a statement on its goodness."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.errors import FitError
from pinav.fitting.engine.posterior import Estimate, Posterior
from pinav.fitting.engine.problem import AbstractProblem, Step
from pinav.fitting.evidence.evidence import Hyperparameters
from pinav.fitting.evidence.model_evidence import LinearFit
from pinav.fitting.outcome import Outcome

SIGNIFICANT = 4.0
"""Standard deviations of chance beyond which a statistic counts as a misfit."""


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

    Raises:
        FitError: there was no step, or the outcome does not count.
    """
    if not steps:
        raise FitError(f"the fit diverged at once: {not_finite}", str(outcome))
    if outcome in advice:
        raise FitError(advice[outcome], str(outcome))
    last = steps[-1]
    posterior, states = problem.posterior(last), last.move.states
    series, chosen = problem.residual_series(last), last.hyperparameters
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
        goodness=None
        if series is None
        else goodness_of_fit(
            series,
            chosen.noise,
            last.quadratic.num_free - last.num_determined,
            noise_known=problem.noise is not None,
        ),
    )
