"""A fit with the evidence as a problem: its unknowns, its start and its steps."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from pinav.dynamics import FixedStep
from pinav.errors import FitError, InputError
from pinav.fitting.bayes.parameters import (
    check_learned,
    is_weight,
    learned_environment,
    num_positions,
    parameter_names,
    unknowns,
)
from pinav.fitting.bayes.steps import (
    AbstractStepRule,
    ChordSteps,
    FullStep,
    Local,
    Move,
    ShortenedStep,
)
from pinav.fitting.engine.multiple_shooting import (
    Linearisation,
    ParametricModel,
    linearise,
)
from pinav.fitting.engine.posterior import Posterior
from pinav.fitting.evidence.evidence import Hyperparameters
from pinav.fitting.evidence.model_evidence import LinearFit
from pinav.fitting.evidence.quadratic import (
    FlatBlock,
    Quadratic,
    eliminate_flat,
    joint_posterior,
)
from pinav.fitting.evidence.weights import (
    AbstractWeights,
    GaussianWeights,
    Inference,
    NoWeights,
)
from pinav.fitting.matching.objectives import Observations
from pinav.trajectories import smoothed_states


class Step(eqx.Module):
    """One step: what the data said before it, and where it led.

    Attributes:
        defect: the largest, relative to the spread of its channel.
        inference: hyperparameters and weights of the linear model.
        quadratic: the sum of squares, as a function of the weights.
        block: the other parameters, given the weights.
        covariance: of all parameters.
        move: where the step led.
        weights: their prior, about the point of linearisation.
    """

    defect: float
    inference: Inference
    quadratic: Quadratic
    block: FlatBlock
    covariance: Float[np.ndarray, "parameter parameter"]
    move: Move
    weights: AbstractWeights


class BayesProblem(eqx.Module):
    """The start of a fit, and its parts that do not change while it runs.

    Attributes:
        free: the model as a function of its parameters.
        theta: the parameters at the start.
        states: about which the dynamics are linearised first.
        num_free: observations less starts.
        weights: what is known of the weights before the data.
        descent: how to step.
        tolerance: change of the log evidence at which the fit ends.
        names: of all parameters.
        flat: which of them have a flat prior.
        observations: the data.
        scale: spread of each channel.
        noise: standard deviation of the data, where it is known.
        solver: steps between samples.
        teacher: the fit that chose the prior of the weights, where it was another.
    """

    free: ParametricModel
    theta: Float[np.ndarray, " parameter"]
    states: Float[jax.Array, "trajectory time state"]
    num_free: int
    weights: AbstractWeights
    descent: AbstractStepRule
    tolerance: float
    names: tuple[str, ...]
    flat: Bool[np.ndarray, " parameter"]
    observations: Observations
    scale: Float[np.ndarray, " state"]
    noise: float | None
    solver: FixedStep
    teacher: LinearFit | None = None

    @classmethod
    def of(
        cls,
        model,
        trajectories,
        learn,
        noise,
        solver,
        *,
        states=None,
        weights=None,
        teacher=None,
    ):
        free, theta = unknowns(model, learn)
        names, flat = parameter_names(free, theta), ~is_weight(free, theta)
        check_learned(model, names, flat)
        dim = num_positions(model, trajectories)
        states = smoothed_states(trajectories, dim) if states is None else states
        num_free = trajectories.num_observed - states[:, 0].size
        if num_free <= flat.sum():
            raise InputError(
                f"fit_bayes trajectories: {trajectories.num_observed} observations "
                "are no more than the starts and constants to be found; add samples"
            )
        if learn is None:
            weights, descent, tolerance = NoWeights(), FullStep(), TOLERANCE
        else:
            weights, descent, tolerance = _method(model, weights)
        return cls(
            free=free,
            theta=np.asarray(theta),
            states=jnp.asarray(states),
            num_free=num_free,
            weights=weights,
            descent=descent,
            tolerance=tolerance,
            names=names,
            flat=flat,
            observations=Observations.of(trajectories, jnp.float64),
            scale=_spread(states, trajectories.lengths),
            noise=noise,
            solver=solver,
            teacher=teacher,
        )

    def step(self, move: Move, shape) -> Step | None:
        """One step, or None where the linearisation is not finite."""
        theta, states = move.theta, move.states
        linear = linearise(
            self.free, jnp.asarray(theta), states, self.observations, self.solver
        )
        if not np.all(np.isfinite(linear.start_factor)):
            return None
        _check_starts(linear)
        if not np.all(np.isfinite(linear.hessian)):
            return None
        quadratic, block = eliminate_flat(self.quadratic(theta, linear), self.flat)
        weights = self.weights.about(theta[~self.flat])
        found = weights.infer(quadratic, shape, self.noise)
        chosen = found.hyperparameters
        mean, covariance = joint_posterior(
            block, found.mean, found.covariance, chosen.noise
        )
        local = Local(
            free=self.free,
            observations=self.observations,
            solver=self.solver,
            theta=theta,
            states=states,
            linear=linear,
            precision=self.precision(chosen),
            noise=chosen.noise,
            energy=lambda theta: weights.energy(theta[~self.flat]),
        )
        return Step(
            defect=float(np.max(np.asarray(linear.defects) / self.scale)),
            inference=found,
            quadratic=quadratic,
            block=block,
            covariance=covariance,
            move=move.descent(local, mean),
            weights=weights,
        )

    def precision(self, chosen: Hyperparameters):
        """Prior precision of each parameter on its own; zero where it is flat."""
        precision = np.zeros(len(self.flat))
        precision[~self.flat] = self.weights.ridge(chosen)
        return precision

    def quadratic(self, theta, linear: Linearisation) -> Quadratic:
        diagonals = np.diagonal(np.asarray(linear.start_factor), axis1=1, axis2=2)
        return Quadratic(
            theta,
            np.asarray(linear.hessian),
            np.asarray(linear.gradient),
            float(linear.squares),
            num_free=self.num_free,
            log_determinant=2 * float(np.log(np.abs(diagonals)).sum()),
        )

    def linear_fit(self, step: Step) -> LinearFit:
        """The linear problem of a step, for the evidence of the model."""
        counts = np.asarray(self.observations.observed).sum(axis=(1, 2))
        state, total = self.states.shape[2], int(counts.sum())
        return LinearFit(
            quadratic=step.quadratic,
            weights=step.weights,
            noise=self.noise,
            num_observed=total,
            flat_information=float(
                state * np.log(counts).sum() + self.flat.sum() * np.log(total)
            ),
            teacher=self.teacher,
        )

    def with_shape_uncertainty(self, step: Step) -> Posterior:
        """The posterior after a step, that of the prior's shape included."""
        extra = step.weights.shape_covariance(
            step.quadratic, step.inference.hyperparameters, self.noise
        )
        covariance = step.covariance + step.block.lift(extra)
        return Posterior(self.free, step.move.theta, covariance)


def _method(
    model, weights: AbstractWeights | None
) -> tuple[AbstractWeights, AbstractStepRule, float]:
    """Prior of the weights, steps as curved as they are, and when to stop."""
    environment = learned_environment(model)
    if weights is not None:
        return weights, ShortenedStep(), NETWORK_TOLERANCE
    if environment is None:
        return NoWeights(), ChordSteps(damping=1e-2), TOLERANCE
    weights = GaussianWeights(environment.prior())
    if environment.is_linear:
        return weights, FullStep(), TOLERANCE
    return weights, ChordSteps(damping=1e3), NETWORK_TOLERANCE


TOLERANCE, NETWORK_TOLERANCE = 1e-2, 2.0
"""Change of the log evidence at which a fit ends. That of a network goes on to creep
while weights shrink on which the data do not depend."""


def _spread(states, lengths):
    """Standard deviation of each channel over all samples; 1 where it is constant."""
    samples = np.concatenate(
        [own[:length] for own, length in zip(states, lengths, strict=True)]
    )
    spread = samples.std(axis=0)
    return np.where(spread > 0, spread, 1.0)


def _check_starts(linear: Linearisation) -> None:
    for index, factor in enumerate(np.asarray(linear.start_factor)):
        lengths = np.linalg.norm(factor, axis=0)
        if lengths.all():
            values = np.linalg.svd(factor / lengths, compute_uv=False)
        if not lengths.all() or values[-1] < 1e-13 * values[0]:
            raise FitError(
                f"the fit is singular: the observations of trajectory {index} do not "
                "determine its start; drop the trajectory"
            )
