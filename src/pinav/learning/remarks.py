"""Sentences on how a fit ended and what limits it, each with a remedy."""

from typing import Any

import numpy as np

from pinav.dynamics import Swimmer
from pinav.evaluation import predict, score
from pinav.fitting import Outcome, confirm, diagnose, simpler_models
from pinav.fitting.evidence.evidence import Hyperparameters
from pinav.fitting.evidence.hyperparameter_uncertainty import is_confined
from pinav.forces import as_learned_force
from pinav.learning.plan import FitPlan
from pinav.trajectories import Trajectories

REMARKS = {
    str(Outcome.STALLED): (
        "The fit stopped before its steps became negligible. If the errors above are "
        "not at the level of the noise, raise --max-steps or choose another --model."
    ),
    str(Outcome.MISFIT): (
        "The fit has found its best parameters, and yet the residuals are no noise: "
        "the model is too small for these data (--width, or another --model), or the "
        "known physics (--system) are wrong."
    ),
    str(Outcome.UNDER_RESOLVED): (
        "The kernels are coarser than what the data show, and finer ones would be too "
        "many: fit fewer or shorter trajectories, or a smaller region."
    ),
}
"""Sentences on how a fit ended, by the word of its outcome."""


def outcome_remarks(outcome: str) -> tuple[str, ...]:
    """The sentence on how a fit ended, where its word needs one."""
    return (REMARKS[outcome],) if outcome in REMARKS else ()


def narrow_prior(model: Any, chosen: Hyperparameters) -> tuple[str, ...]:
    """What a prior at the edge of its range means for the bands; nothing elsewhere.

    Args:
        model: that was fitted.
        chosen: by the evidence.
    """
    force = as_learned_force(model.environment)
    if force is None or not is_confined(force.prior(), chosen.shape):
        return ()
    return (
        "The prior of the force ended at the narrowest that its kernels allow: the "
        "bands leave other shapes of the force out and are too narrow. Give more "
        "trajectories through the places where the force acts.",
    )


ASSUMED_POTENTIAL = (
    "The force was assumed conservative; this was not tested. If it may have a "
    "rotational part, fit --model kernel-mixture (in space kernel-force), too, and "
    "compare the log evidence."
)
"""What is said of a default that nothing has tested."""


def assumed_potential(plan: FitPlan, model: Any, rotation: float) -> tuple[str, ...]:
    """That the default took the force for a gradient, where nothing weighed it.

    Args:
        plan: of the fit.
        model: that was fitted.
        rotation: log evidence of a rotational part [nats]; NaN where none was weighed.
    """
    force = as_learned_force(model.environment)
    if force is None or not force.is_conservative or plan.data.dim < 2:
        return ()
    return (ASSUMED_POTENTIAL,) if plan.is_open and np.isnan(rotation) else ()


def confirm_outcome(
    outcome: str, loss: float, data: Trajectories, rmse: dict[str, float]
) -> str:
    """The word for how a fit ended, which its independent rollouts confirm.

    Args:
        outcome: the word by the fit's own solver.
        loss: at its end.
        data: that were fitted.
        rmse: errors of independent rollouts.
    """
    if outcome != str(Outcome.CONVERGED):
        return outcome
    residual = float(np.sqrt(loss / data.num_observed))
    total, spread = rmse["total"], data.spread
    return str(confirm(Outcome.CONVERGED, residual, total, spread))


def likely_cause(
    data: Trajectories, model: Any, outcome: str, rmse: dict[str, float]
) -> tuple[str, ...]:
    """Why a fit that misses the data failed, where the data tell it.

    Args:
        data: that were fitted.
        model: that was fitted to them.
        outcome: the word for how the fit ended.
        rmse: errors of independent rollouts.
    """
    close = rmse["total"] <= FAILED * data.spread
    if outcome == str(Outcome.CONVERGED) or close or not isinstance(model, Swimmer):
        return ()
    cause = diagnose(model, data)
    return () if cause is None else (f"The likely cause of the failure: {cause}.",)


FAILED = 1e-3
"""Error of rollouts, in units of the spread of the data, whose cause is looked for."""


def simpler_model(
    plan: FitPlan, outcome: str, rmse: dict[str, float]
) -> tuple[str, ...]:
    """What explains the data far better than a fit that did not converge.

    Args:
        plan: of the fit.
        outcome: the word for how it ended.
        rmse: errors of its independent rollouts.
    """
    if outcome == str(Outcome.CONVERGED):
        return ()
    total = rmse["total"]
    for name, model in simpler_models(plan.system.swimmer, plan.data).items():
        simple = score(*predict(model, plan.data), plan.data).total
        if FAR_BETTER * simple < total or not np.isfinite(total):
            return (
                f"The fit failed: its rollouts miss the data by {total:.2g}, those of "
                f"{name} by {simple:.2g}; choose --model kernel-potential or another "
                "--seed.",
            )
    return ()


FAR_BETTER = 3.0
"""Ratio of errors beyond which a simpler model is recommended."""
