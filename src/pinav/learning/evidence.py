"""The numbers that a run keeps of a fit by the evidence, and its learned constants."""

import dataclasses
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from pinav.arguments import dimension_of
from pinav.dynamics import AbstractDynamics
from pinav.evaluation import field_map
from pinav.fitting import (
    Estimate,
    EvidenceFit,
    Hyperparameters,
    Posterior,
    principal_drags,
    ravel_model,
    rotational_fraction,
)
from pinav.fitting.bayes.function_prior import TangentWeights
from pinav.fitting.engine.evidence_fit import GoodnessOfFit
from pinav.fitting.environments.summary import CONSTANTS, ModelChoice
from pinav.fitting.structure.trace import Hypothesis
from pinav.forces import (
    AbstractLearnedForce,
    KernelForce,
    KernelPotential,
    as_learned_force,
    split_structure,
)
from pinav.systems import System, WanderingVelocity
from pinav.trajectories import Trajectories
from pinav.units import model_unit, with_order

DIMENSIONS = {
    "diffusion": "L2 T-1",
    "exposure": "T",
    "error": "L",
    "rotational fraction": "1",
    "noise of a block": "L",
}
"""Dimension of what a fit learns beside the numbers of a swimmer."""


def with_units(
    estimates: Mapping[str, Estimate], choice: ModelChoice, model: Any, system: System
) -> dict[str, Estimate]:
    """Learned constants with their units."""
    paths = choice.paths()
    return {
        name: with_unit(one, _dimension(name, paths, model), system)
        for name, one in estimates.items()
    }


def with_unit(estimate: Estimate, dimension: str, system: System) -> Estimate:
    """A number of a model with its unit in a system."""
    force = system.base_units.force
    unit = model_unit(dimension, with_order(system.units, system.order, force))
    return Estimate(float(estimate.value), float(estimate.sd), unit)


def _dimension(name: str, paths: Mapping[str, str], model: Any) -> str:
    plain = re.sub(r"\[.*\]$", "", name)
    if plain in DIMENSIONS:
        return DIMENSIONS[plain]
    if plain.startswith("wandering."):
        return dimension_of(WanderingVelocity, plain.removeprefix("wandering."))
    path = CONSTANTS["drag"] if name.startswith("drag ") else paths.get(name, name)
    return dimension_of(model, path)


def estimated_constants(fit: EvidenceFit, choice: ModelChoice) -> dict[str, Estimate]:
    """Each learned constant, by its name; the drag by its principal values."""
    paths = choice.paths()
    estimates = {
        name: estimate
        for name, estimate in fit.constants.items()
        if not name.startswith("environment.terms")
    }
    named = {
        name: estimates.pop(path)
        for name, path in paths.items()
        if path in estimates and path != CONSTANTS["drag"]
    }
    if CONSTANTS["drag"] in paths.values():
        drags = principal_drags(fit.posterior)
        return named | {f"drag {name}": value for name, value in drags.items()}
    return named | estimates


def rotational_part(fit: EvidenceFit, data: Trajectories) -> dict[str, Estimate]:
    """The rotational fraction of a mixture where there are data; else nothing."""
    environment = fit.model.environment
    learned = as_learned_force(environment)
    if learned is None or learned.helmholtz is None or split_structure(learned)[0]:
        return {}
    field = field_map(environment, data)
    visited = field.points[field.distance.ravel() <= field.regions.visited]
    return {"rotational fraction": rotational_fraction(fit.posterior, visited)}


@dataclasses.dataclass(frozen=True)
class SearchResult:
    """Result of a search for a structure of the force.

    Attributes:
        gain: of the structured force over the free one [nats]; NaN where no structure
            explained the data well enough to be fitted, or free kernels alone diverge.
        rotation: of a rotational part beside a potential [nats]; NaN where none was
            weighed.
        tried: the hypotheses, in the order in which they were weighed.
    """

    gain: float
    rotation: float = float("nan")
    tried: tuple[Hypothesis, ...] = ()


@dataclasses.dataclass(frozen=True)
class Evidence:
    """The numbers of a fit by the evidence; the model stands beside them.

    Attributes:
        covariance: their covariance, given the hyperparameters.
        goodness: whether the residuals look like noise; None where nothing can be said.
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
    goodness: GoodnessOfFit | None = None
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
        """The numbers of a fit."""
        chosen = fit.hyperparameters
        return cls(
            mean=np.asarray(fit.posterior.mean),
            covariance=np.asarray(fit.posterior.covariance),
            hyperparameters=Hyperparameters(
                shape=np.asarray(chosen.shape),
                amplitude=float(chosen.amplitude),
                noise=float(chosen.noise),
                log_evidence=float(chosen.log_evidence),
            ),
            constants=estimated_constants(fit, choice) | rotational_part(fit, data),
            states=data.states if fit.states is None else fit.states,
            outcome=str(fit.outcome),
            iterations=fit.iterations,
            goodness=fit.goodness,
            # Where a structure was sought the process is the force of the teacher.
            process=_process(fit, choice) if structure is None else None,
            structure=structure,
            support=support,
        )

    def posterior(
        self,
        model: AbstractDynamics,
        choice: ModelChoice,
        visited: Float[np.ndarray, "place dim"] | None,
    ) -> Posterior:
        """Posterior of the model; ValueError if it has other parameters.

        Args:
            visited: observed positions [L]; None where the force decays beyond them.
        """
        free, theta = ravel_model(model, choice.trainable)
        if theta.shape != self.mean.shape:
            raise ValueError(f"expected {self.mean.size} parameters, got {theta.size}")
        return Posterior(free, self.mean, self.covariance, visited)


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
