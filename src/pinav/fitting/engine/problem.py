"""What a fit by the evidence must provide, and the step that all of them share."""

import abc

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float

from pinav.fitting.engine.constant_priors import ConstantPriors
from pinav.fitting.engine.local_model import (
    AbstractLocalModel,
    PenalisedSquares,
    States,
)
from pinav.fitting.engine.parametric_model import ParametricModel
from pinav.fitting.engine.posterior import Posterior
from pinav.fitting.engine.steps import AbstractStepRule, Move
from pinav.fitting.evidence.evidence import Hyperparameters
from pinav.fitting.evidence.model_evidence import LinearFit
from pinav.fitting.evidence.quadratic import (
    FlatBlock,
    Parameters,
    Quadratic,
    eliminate_flat,
    joint_posterior,
)
from pinav.fitting.evidence.weights import AbstractWeights, Inference


class Step(eqx.Module):
    """One step: what the data said before it, and where it led.

    Attributes:
        defect: distance from a solution; see `AbstractLocalModel.defect`.
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

    @property
    def hyperparameters(self) -> Hyperparameters:
        """The chosen ones."""
        return self.inference.hyperparameters

    @property
    def num_determined(self) -> float:
        """Weights that the data, not the prior, determine."""
        variance = max(self.hyperparameters.noise**2, np.finfo(float).tiny)
        weights = self.inference.covariance
        return float(np.sum(self.quadratic.hessian * weights)) / variance


class AbstractProblem(eqx.Module):
    """Residuals of a model with a prior: the start of a fit, and how it steps.

    Attributes:
        parametric: the model as a function of its parameters.
        theta: the parameters at the start.
        states: about which dynamics are linearised first; None without dynamics.
        weights: what is known of the weights before the data.
        priors: what is known of the other parameters; flat unless given.
        step_rule: how to move to the next point of linearisation.
        tolerance: change of the log evidence at which the fit ends.
        names: of all parameters.
        flat: which of them are no weights.
        noise: standard deviation of the residuals, where it is known.
        first_noise: a guess of it, for the first step.
        least_noise: below which residuals are rounding.
        teacher: the fit that chose the prior of the weights, where it was another.
    """

    parametric: eqx.AbstractVar[ParametricModel]
    theta: eqx.AbstractVar[Parameters]
    states: eqx.AbstractVar[Float[Array, "trajectory time state"] | None]
    weights: eqx.AbstractVar[AbstractWeights]
    priors: eqx.AbstractVar[ConstantPriors]
    step_rule: eqx.AbstractVar[AbstractStepRule]
    tolerance: eqx.AbstractVar[float]
    names: eqx.AbstractVar[tuple[str, ...]]
    flat: eqx.AbstractVar[Bool[np.ndarray, " parameter"]]
    noise: eqx.AbstractVar[float | None]
    first_noise: eqx.AbstractVar[float]
    least_noise: eqx.AbstractVar[float]
    teacher: eqx.AbstractVar[LinearFit | None]

    @abc.abstractmethod
    def linearise(self, theta: Parameters, states: States) -> AbstractLocalModel | None:
        """The residuals about a point; None where they are not finite.

        Raises:
            FitError: the data leave something undetermined.
        """

    @abc.abstractmethod
    def flat_information(self) -> tuple[int, float]:
        r"""Number of residuals, and $\sum_j \log n_j$ over unknowns with a flat prior.

        See `LinearFit`.
        """

    def residual_series(
        self, step: Step
    ) -> list[Float[np.ndarray, "_ channel"]] | None:
        """Residuals after a step in the order of time; None where they have none."""
        return None

    def step(self, move: Move, before: Hyperparameters | None) -> Step | None:
        """One step; None where the residuals are not finite.

        Args:
            move: where the step before led.
            before: the hyperparameters that it chose; None at the start.
        """
        local = self.linearise(move.theta, move.states)
        if local is None:
            return None
        last_noise = self.first_noise if before is None else before.noise
        noise = last_noise if self.noise is None else self.noise
        # A prior is one more residual in units of the noise, which is not known before
        # the step: that of the step before stands for it.
        noise = max(noise, self.least_noise)
        whole = self.priors.add_to(local.quadratic, noise)
        quadratic, block = eliminate_flat(whole, self.flat)
        weights = self.weights.about(move.theta[~self.flat])
        if before is None:
            shape = weights.first_shape(quadratic, self.noise)
        else:
            shape = before.shape
        inference = self._without_stale_noise(
            weights.infer(quadratic, shape, self.noise), noise
        )
        chosen = inference.hyperparameters
        mean, covariance = joint_posterior(
            block, inference.mean, inference.covariance, chosen.noise
        )
        precision = np.zeros(len(self.flat))
        precision[~self.flat] = weights.ridge(chosen)
        cost = PenalisedSquares(
            local=local,
            precision=precision,
            noise=max(chosen.noise, self.least_noise),
            energy=lambda theta: weights.energy(theta[~self.flat]),
            priors=self.priors,
        )
        return Step(
            defect=local.defect(mean, chosen.noise),
            inference=inference,
            quadratic=quadratic,
            block=block,
            covariance=covariance,
            move=move.rule(cost, mean),
            weights=weights,
        )

    def _without_stale_noise(self, inference: Inference, before: float) -> Inference:
        """The evidence with the priors in units of the noise that was chosen.

        In those of the step before each prior would add the logarithm of the change.
        """
        count, noise = len(self.priors.entries), inference.hyperparameters.noise
        if not count:
            return inference
        change = np.log(max(noise, self.least_noise, np.finfo(float).tiny) / before)
        return eqx.tree_at(
            lambda one: one.hyperparameters.log_evidence,
            inference,
            inference.hyperparameters.log_evidence + count * float(change),
        )

    def posterior(self, step: Step) -> Posterior:
        """The posterior after a step, that of the prior's shape included."""
        extra = step.weights.shape_covariance(
            step.quadratic, step.hyperparameters, self.noise
        )
        covariance = step.covariance + step.block.lift(extra)
        return Posterior(
            self.parametric, step.move.theta, covariance, step.hyperparameters
        )

    def linear_fit(self, step: Step) -> LinearFit:
        """The linear problem of a step, for the evidence of the model."""
        count, information = self.flat_information()
        return LinearFit(
            quadratic=step.quadratic,
            weights=step.weights,
            noise=self.noise,
            num_observed=count,
            flat_information=information,
            teacher=self.teacher,
        )
