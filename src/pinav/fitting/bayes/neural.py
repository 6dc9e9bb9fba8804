"""Networks distilled from kernels: the force to start from, and a prior of forces.

A teacher is fitted to the same data first: kernels of the same kind, with structured
terms beside them where `fit_structured` finds a structure. A static network gets the
Gaussian process of its teacher as the prior of its forces (`function_prior`); one that
sees the time, which the teacher does not, may have a prior of one variance for all its
weights instead.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.dynamics import FixedStep
from pinav.fitting.bayes.distillation import (
    OF_KERNELS,
    OF_STRUCTURE,
    Distillation,
    DistillationTargets,
    distil,
    distillation_targets,
)
from pinav.fitting.bayes.function_prior import Process, TangentWeights
from pinav.fitting.bayes.parameters import Learn, num_positions
from pinav.fitting.bayes.problem import BayesProblem
from pinav.fitting.engine.evidence_fit import EvidenceFit
from pinav.fitting.engine.problem import AbstractProblem, Step
from pinav.fitting.environments.kernels import first_kernels, observed_positions
from pinav.fitting.evidence.evidence import Hyperparameters, LinearisedObservations
from pinav.fitting.evidence.hyperparameter_uncertainty import shape_changes
from pinav.fitting.evidence.model_evidence import LinearFit
from pinav.forces import AbstractForce, AbstractLearnedForce, split_structure
from pinav.trajectories import Trajectories


class FitSpecification(eqx.Module):
    """What is asked of a fit.

    Attributes:
        noise: standard deviation of the observations, where it is known.
    """

    model: Any
    trajectories: Trajectories
    learn: Learn
    noise: float | None
    solver: FixedStep

    @property
    def dim(self) -> int:
        """How many channels are positions."""
        return num_positions(self.model, self.trajectories)

    def kernels(self) -> Any:
        """Untrained kernels of the same kind as the network."""
        positions = observed_positions(self.trajectories, self.dim)
        return first_kernels(self.model.environment.kernels_on, positions)

    def problem(self, model: Any, **options: Any) -> BayesProblem:
        """The fit of another model to the same data."""
        return BayesProblem.of(
            model, self.trajectories, self.learn, self.noise, self.solver, **options
        )

    def by_kernels(self) -> BayesProblem:
        """The fit of the kernels."""
        kernels = self.kernels()
        return self.problem(eqx.tree_at(lambda m: m.environment, self.model, kernels))

    def distill(self, teacher: "Teacher") -> tuple[Any, DistillationTargets]:
        """The network, distilled from the force of its teacher, and that force."""
        force: Any = teacher.model.environment
        targets = distillation_targets(
            force,
            self.trajectories,
            teacher.states,
            dim=self.dim,
            width=float(force.kernels.width),
            how=_way_for(force),
        )
        network = distil(self.model.environment, targets, _way_for(force))
        return network, targets

    def by_process(
        self, teacher: "Teacher", network: Any, targets: DistillationTargets
    ) -> BayesProblem:
        """The fit of a network whose forces have the process of its teacher."""
        force = teacher.model.environment
        prior, chosen = force.prior(), teacher.chosen
        data = LinearisedObservations.of(teacher.linear.quadratic)
        shapes = shape_changes(data, prior, chosen, self.noise)
        process = Process.of(force, prior, chosen, targets, shapes)
        wanted = np.asarray(targets.forces).ravel()
        weights = TangentWeights.of(network, targets, process, wanted)
        return self.by_weights(teacher, network, weights)

    def by_weights(
        self, teacher: "Teacher", network: Any, weights: TangentWeights | None = None
    ) -> BayesProblem:
        """The fit of a distilled network, its weights of one variance unless given."""
        return self.problem(
            eqx.tree_at(lambda m: m.environment, teacher.model, network),
            states=teacher.states,
            weights=weights,
            teacher=teacher.linear,
        )


def _way_for(force: AbstractForce) -> Distillation:
    """The way in which a network learns a force."""
    return OF_STRUCTURE if split_structure(force)[0] else OF_KERNELS


class Teacher(eqx.Module):
    """A fit of kernels, with terms beside them or alone, that a network learns from.

    Attributes:
        states: the smoothed states.
    """

    model: Any
    states: Float[np.ndarray, "trajectory time state"]
    chosen: Hyperparameters
    linear: LinearFit

    @classmethod
    def of_step(cls, problem: AbstractProblem, step: Step) -> "Teacher":
        """After a step of its fit."""
        return cls(
            model=problem.parametric(jnp.asarray(step.move.theta)),
            states=np.asarray(step.move.states),
            chosen=step.hyperparameters,
            linear=problem.linear_fit(step),
        )

    @classmethod
    def of_fit(cls, fit: EvidenceFit) -> "Teacher":
        """At the end of its fit, which is one of trajectories."""
        if fit.states is None:
            raise ValueError("Teacher.of_fit: expected the fit of trajectories")
        return cls(fit.model, fit.states, fit.hyperparameters, fit.linear)


def function_prior(
    request: FitSpecification,
    states: Float[np.ndarray, "trajectory time state"],
    chosen: Hyperparameters,
    kernels: AbstractLearnedForce | None = None,
) -> TangentWeights:
    """The prior with which a static network was fitted, but for its shape's changes.

    Args:
        states: the smoothed states.
        kernels: of the process (`Process.kernels`); those with which every fit begins
            unless given.
    """
    made: Any = request.kernels() if kernels is None else kernels
    network = request.model.environment
    places: DistillationTargets = distillation_targets(
        network,
        request.trajectories,
        states,
        dim=request.dim,
        width=float(made.kernels.width),
        how=_way_for(made),
    )
    prior = made.prior()
    none = np.zeros((len(prior.covariance(chosen.shape)), 0))
    process = Process.of(made, prior, chosen, places, none)
    wanted = process.nearest(np.asarray(places.forces).ravel())
    return TangentWeights.of(network, places, process, wanted)
