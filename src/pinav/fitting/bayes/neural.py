"""Networks distilled from kernels: the force to start from, and a prior of forces.

The kernel environment of the same kind is fitted to the same data first. A static
network gets the Gaussian process of these kernels as the prior of its forces
(`tangent`); one that sees the time, which the kernels do not, keeps a prior of one
variance for all its weights.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.dynamics import FixedStep
from pinav.fitting.bayes.distillation import (
    DistillationTargets,
    distil,
    distillation_targets,
)
from pinav.fitting.bayes.function_prior import Process, TangentWeights
from pinav.fitting.bayes.parameters import Learn, num_positions
from pinav.fitting.bayes.problem import BayesProblem
from pinav.fitting.engine.problem import AbstractProblem, Step
from pinav.fitting.environments.kernels import lay_kernels
from pinav.fitting.evidence.evidence import Hyperparameters, LinearisedObservations
from pinav.fitting.evidence.hyperparameter_uncertainty import shape_changes
from pinav.forces import AbstractLearnedForce
from pinav.trajectories import Trajectories


class FitSpecification(eqx.Module):
    """What is asked of a fit.

    Attributes:
        model: dynamics with an environment.
        trajectories: the data.
        learn: the constants to learn; None where all is known.
        noise: standard deviation of the observations, where it is known.
        solver: steps between samples.
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
        places = lay_kernels(self.trajectories, None, self.dim)
        return self.model.environment.kernels_on(*places)

    def problem(self, model: Any, **options: Any) -> BayesProblem:
        """The fit of another model to the same data."""
        return BayesProblem.of(
            model, self.trajectories, self.learn, self.noise, self.solver, **options
        )

    def by_kernels(self) -> BayesProblem:
        """The fit of the kernels."""
        kernels = self.kernels()
        return self.problem(eqx.tree_at(lambda m: m.environment, self.model, kernels))

    def distill(self, problem: AbstractProblem, step: Step) -> BayesProblem:
        """The fit of the network, after the last step of the fit of the kernels."""
        teacher = problem.parametric(jnp.asarray(step.move.theta))
        states = np.asarray(step.move.states)
        places = distillation_targets(
            teacher.environment,
            self.trajectories,
            states,
            dim=self.dim,
            width=float(teacher.environment.width),
        )
        network = distil(self.model.environment, places)
        weights, chosen = None, step.inference.hyperparameters
        if network.is_static:
            prior = teacher.environment.prior()
            data = LinearisedObservations.of(step.quadratic)
            shapes = shape_changes(data, prior, chosen, self.noise)
            process = Process.of(teacher.environment, prior, chosen, places, shapes)
            wanted = np.asarray(places.forces).ravel()
            weights = TangentWeights.of(network, places, process, wanted)
        start = eqx.tree_at(lambda m: m.environment, teacher, network)
        return self.problem(
            start, states=states, weights=weights, teacher=problem.linear_fit(step)
        )


def function_prior(
    request: FitSpecification,
    states: Float[np.ndarray, "trajectory time state"],
    chosen: Hyperparameters,
    kernels: AbstractLearnedForce | None = None,
) -> TangentWeights:
    """The prior with which a static network was fitted, but for its shape's changes.

    Args:
        request: the fit, with the fitted model.
        states: the smoothed states.
        chosen: hyperparameters of the fit.
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
        width=float(made.width),
    )
    prior = made.prior()
    none = np.zeros((len(prior.covariance(chosen.shape)), 0))
    process = Process.of(made, prior, chosen, places, none)
    wanted = process.nearest(np.asarray(places.forces).ravel())
    return TangentWeights.of(network, places, process, wanted)
