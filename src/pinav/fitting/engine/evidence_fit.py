"""The result of every fit whose hyperparameters are chosen by the evidence."""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.fitting.engine.posterior import Estimate, Posterior
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
    """

    model: Any
    outcome: Outcome = eqx.field(static=True)
    iterations: int = eqx.field(static=True)
    hyperparameters: Hyperparameters
    posterior: Posterior
    constants: dict[str, Estimate]
    states: Float[np.ndarray, "trajectory time state"] | None
    linear: LinearFit
