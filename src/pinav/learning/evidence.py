"""What a fit by the evidence found: the numbers of it that a run keeps."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

from pinav.dynamics import AbstractDynamics
from pinav.fitting import Estimate, EvidenceFit, Hyperparameters, Posterior, ravel_model
from pinav.fitting.bayes.function_prior import TangentWeights
from pinav.fitting.environments.choice import ModelChoice
from pinav.forces import AbstractLearnedForce, KernelForce, KernelPotential
from pinav.learning.constants import estimated_constants, rotational_part
from pinav.trajectories import Trajectories


@dataclasses.dataclass(frozen=True)
class SearchResult:
    """The log evidence that a search for a structure of the force weighed.

    Attributes:
        gain: of the structured force over the free one [nats]; NaN where no structure
            explained the data well enough to be fitted, or free kernels alone diverge.
        rotation: of a rotational part beside a potential [nats]; NaN where none was
            weighed.
    """

    gain: float
    rotation: float = float("nan")


@dataclasses.dataclass(frozen=True)
class Evidence:
    """The numbers of a fit by the evidence; the model stands beside them.

    Attributes:
        mean: best values of the learned parameters.
        covariance: their covariance, given the hyperparameters.
        hyperparameters: chosen by the evidence.
        constants: learned constants by name.
        states: smoothed states of the training trajectories.
        outcome: the word for how the fit ended.
        iterations: steps taken.
        goodness: a sentence on whether the residuals look like noise; empty where
            nothing can be said.
        process: the force whose process is the prior of a network that free kernels
            taught.
        structure: what the search for a structure weighed; None without a search.
        support: log evidence of a field beside commands over none [nats]; None where it
            was not asked.
    """

    mean: Float[np.ndarray, " parameter"]
    covariance: Float[np.ndarray, "parameter parameter"]
    hyperparameters: Hyperparameters
    constants: dict[str, Estimate]
    states: Float[np.ndarray, "trajectory time state"]
    outcome: str
    iterations: int
    goodness: str = ""
    process: AbstractLearnedForce | None = None
    structure: SearchResult | None = None
    support: float | None = None

    @classmethod
    def of(
        cls,
        fit: EvidenceFit,
        choice: ModelChoice,
        data: Trajectories,
        structure: SearchResult | None = None,
        support: float | None = None,
    ) -> "Evidence":
        """The numbers of a fit.

        Args:
            fit: of the data.
            choice: what was fitted.
            data: the trajectories.
            structure: what a search weighed.
            support: log evidence of a field beside commands over none [nats].
        """
        return cls(
            mean=np.asarray(fit.posterior.mean),
            covariance=np.asarray(fit.posterior.covariance),
            hyperparameters=_plain(fit.hyperparameters),
            constants=estimated_constants(fit, choice) | rotational_part(fit, data),
            states=data.states if fit.states is None else fit.states,
            outcome=str(fit.outcome),
            iterations=fit.iterations,
            goodness=fit.goodness.statement if fit.goodness else "",
            # Where a structure was sought the process is the force of the teacher.
            process=_process(fit, choice) if structure is None else None,
            structure=structure,
            support=support,
        )

    def posterior(self, model: AbstractDynamics, choice: ModelChoice) -> Posterior:
        """The distribution of the parameters of the fitted model.

        Raises:
            ValueError: the model has another number of parameters.
        """
        free, theta = ravel_model(model, choice.trainable)
        if theta.shape != self.mean.shape:
            raise ValueError(f"expected {self.mean.size} parameters, got {theta.size}")
        return Posterior(free, self.mean, self.covariance, self.hyperparameters)


def _plain(chosen: Hyperparameters) -> Hyperparameters:
    """The same with numbers that are no arrays of a device."""
    return Hyperparameters(
        shape=np.asarray(chosen.shape),
        amplitude=float(chosen.amplitude),
        noise=float(chosen.noise),
        log_evidence=float(chosen.log_evidence),
    )


def _process(
    fit: EvidenceFit, choice: ModelChoice
) -> KernelForce | KernelPotential | None:
    """The kernels of the process that is the prior of a network; else nothing."""
    weights = fit.linear.weights
    if not isinstance(weights, TangentWeights):
        return None
    kernels: Any = weights.process.kernels
    kind = KernelForce if choice.name == "neural-force" else KernelPotential
    return kind.with_zero_weights(np.asarray(kernels.centers), float(kernels.width))
