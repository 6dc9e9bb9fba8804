r"""Step rules, and what a fit by the evidence must provide.

Kernels are linear in their weights: the full step to the mean of the posterior is
right. Networks and parametric forces are not, and move by damped steps whose damping
is chosen by what the parameters explain in truth.
"""

import abc
from operator import attrgetter

import equinox as eqx
import numpy as np
import scipy.linalg
from jaxtyping import Array, Bool, Float

from pinav.fitting.engine.local_model import (
    AbstractLocalModel,
    ConstantPriors,
    ParametricModel,
    PenalisedSquares,
    Prediction,
    States,
)
from pinav.fitting.engine.posterior import Posterior
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

CHORD_STEPS = 4
"""Steps with the Jacobian held, for each damping."""

EXPONENTS = range(-3, 2)
"""Dampings tried, as powers of ten of the last one."""


class Move(eqx.Module):
    """Where a step leads."""

    theta: Parameters
    states: States
    rule: "AbstractStepRule"


class AbstractStepRule(eqx.Module):
    """Chooses the next point of linearisation."""

    @abc.abstractmethod
    def __call__(self, cost: PenalisedSquares, mean: Parameters) -> Move:
        """The next point, given the `mean` of the linear model's posterior."""


class FullStep(AbstractStepRule):
    """To the mean of the posterior: right for a model linear in its parameters."""

    def __call__(self, cost: PenalisedSquares, mean: Parameters) -> Move:
        return Move(mean, cost.local.advance(mean), self)


class ShortenedStep(AbstractStepRule):
    """To the mean of the posterior, or as far towards it as lowers the true cost.

    For a model that is nearly linear, because it starts close to its best fit. Where a
    linearisation costs many predictions, corrections with the true residuals and the
    Jacobian held spare some.

    Attributes:
        corrections: after the step, at most; each lowers the cost by `WORTH` or more.
    """

    corrections: int = 0

    def __call__(self, cost: PenalisedSquares, mean: Parameters) -> Move:
        start, change = cost.local.theta, mean - cost.local.theta
        here = cost.local.predict(start)
        before = cost.cost(start, here.residuals)
        for power in range(HALVINGS):
            theta = start + 0.5**power * change
            prediction = cost.local.predict(theta)
            after = cost.cost(theta, prediction.residuals)
            if after < before:
                return self._correct(cost, theta, prediction, after)
        return Move(start, here.states, self)

    def _correct(
        self,
        cost: PenalisedSquares,
        theta: Parameters,
        prediction: Prediction,
        before: float,
    ) -> Move:
        for _ in range(self.corrections):
            # A chord: the Jacobian of the start with the residuals of here.
            slope = cost.half_gradient(theta, prediction.residuals)
            change = scipy.linalg.solve(cost.hessian, slope, assume_a="pos")
            if slope @ change < WORTH:
                break
            trial = cost.local.predict(theta - change)
            after = cost.cost(theta - change, trial.residuals)
            if not after < before:
                break
            theta, prediction, before = theta - change, trial, after
        return Move(theta, prediction.states, self)


HALVINGS = 8
"""Lengths tried at most."""

WORTH = 0.1
"""Decrease of the cost, twice the nats, for which a correction is worth its run."""


class ChordSteps(AbstractStepRule):
    r"""Damped steps with the true residuals and the Jacobian held.

    For several dampings $\lambda$ and $P$, the Hessian of the cost, a few times
    $d \leftarrow d - (P + \lambda D)^{-1}(g(\theta + d) + \lambda D d)$, with the
    gradient $g$ of the true residuals. $D$ is the precision of the prior, or the
    diagonal of $P$ where all priors are flat or `by_curvature` is true. Among all, the
    smallest damping wins that gains at least half as much as the best: the greedy
    choice converges slowly.

    Attributes:
        damping: the last one that won.
        by_curvature: whether $D$ is the diagonal of $P$ in any case.

    References:
        Levenberg 1944; Marquardt 1963.
    """

    damping: float
    by_curvature: bool = False

    def __call__(self, cost: PenalisedSquares, mean: Parameters) -> Move:
        start, hessian = cost.local.theta, cost.hessian
        flat = self.by_curvature or not np.any(cost.precision)
        # Damping in units of the prior, or of the curvature where there is no prior.
        scale = np.diag(hessian) if flat else cost.precision
        here = cost.local.predict(start)
        before = cost.cost(start, here.residuals)
        dampings = [self.damping * 10.0**power for power in EXPONENTS]
        trials = [
            _chord(cost, hessian, damping * scale, here.residuals)
            for damping in dampings
        ]
        gains = before - np.array([value for _, value in trials])
        if not gains.max() > 0:
            rule = ChordSteps(100 * self.damping, self.by_curvature)
            return Move(start, here.states, rule)
        # The least damping that gains half of what the best one does keeps the search
        # quick.
        chosen = int(np.argmax(gains >= 0.5 * gains.max()))
        theta = trials[chosen][0]
        rule = ChordSteps(max(dampings[chosen], LEAST_DAMPING), self.by_curvature)
        return Move(theta, cost.local.predict(theta).states, rule)


LEAST_DAMPING = 1e-6
"""Below this a damping changes nothing."""


def _chord(
    cost: PenalisedSquares,
    hessian: Float[np.ndarray, "parameter parameter"],
    damping: Parameters,
    residuals: Float[Array, "..."],
) -> tuple[Parameters, float]:
    """Best parameters for one damping, and their cost."""
    start = cost.local.theta
    try:
        factor = scipy.linalg.cho_factor(hessian + np.diag(damping))
    except scipy.linalg.LinAlgError:
        return start, np.inf
    theta, best, lowest = start, start, np.inf
    for _ in range(CHORD_STEPS):
        # the true residuals with the Jacobian of the start: one costs a small part of
        # the other, and their fixed point is that of full Gauss-Newton steps
        pull = cost.half_gradient(theta, residuals) + damping * (theta - start)
        theta = theta - scipy.linalg.cho_solve(factor, pull)
        residuals = cost.local.predict(theta).residuals
        value = cost.cost(theta, residuals)
        if not value < np.inf:
            break
        if value < lowest:
            best, lowest = theta, value
    return best, lowest


class Step(eqx.Module):
    """One step: what the data said before it, and where it led.

    Attributes:
        defect: distance from a solution; see `AbstractLocalModel.defect`.
        quadratic: the sum of squares, as a function of the weights.
        block: the other parameters, given the weights.
        covariance: of all parameters.
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
        theta: the parameters at the start.
        states: about which dynamics are linearised first; None without dynamics.
        weights: what is known of the weights before the data.
        priors: what is known of the other parameters; flat unless given.
        tolerance: change of the log evidence at which the fit ends.
        flat: which of them are no weights.
        noise: standard deviation of the residuals, where it is known.
        first_noise: a guess of it, for the first step.
        least_noise: below which residuals are rounding.
        teacher: the fit that chose the prior of the weights, where it was another.
        visited: observed positions [L]; None of residuals that are of no swimmer.
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
    visited: eqx.AbstractVar[Float[np.ndarray, "place dim"] | None]

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
        told = inference.hyperparameters.log_evidence + count * float(change)
        where = attrgetter("hyperparameters.log_evidence")
        return eqx.tree_at(where, inference, told)

    def posterior(self, step: Step) -> Posterior:
        """The posterior after a step, that of the prior's shape included."""
        extra = step.weights.shape_covariance(
            step.quadratic, step.hyperparameters, self.noise
        )
        covariance = step.covariance + step.block.lift(extra)
        return Posterior(self.parametric, step.move.theta, covariance, self.visited)

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
