"""The result of every fit whose hyperparameters are chosen by the evidence."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.errors import FitError
from pinav.fitting.engine.goodness import GoodnessOfFit, goodness_of_fit
from pinav.fitting.engine.posterior import Estimate, Posterior
from pinav.fitting.engine.problem import AbstractProblem, Step
from pinav.fitting.evidence.evidence import Hyperparameters
from pinav.fitting.evidence.model_evidence import LinearFit
from pinav.fitting.outcome import Outcome


class EvidenceFit(eqx.Module):
    """A fitted model, and how well it is known.

    Attributes:
        model: the model with its best parameters.
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
        problem: in which it ended.
        outcome: how.
        steps: those taken.
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
