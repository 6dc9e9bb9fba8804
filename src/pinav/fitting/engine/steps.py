r"""Step rules: how a fit moves from one linearisation to the next.

Kernels are linear in their weights: the full step to the mean of the posterior is
right. Networks and parametric forces are not, and move by damped steps whose damping
is chosen by what the parameters explain in truth.
"""

import abc

import equinox as eqx
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float

from pinav.fitting.engine.local_model import PenalisedSquares, Prediction, States
from pinav.fitting.evidence.quadratic import Parameters

CHORD_STEPS = 4
"""Steps with the Jacobian held, for each damping."""

EXPONENTS = range(-3, 2)
"""Dampings tried, as powers of ten of the last one."""


class Move(eqx.Module):
    """Where a step leads.

    Attributes:
        theta: the parameters.
        states: about which to linearise next.
        rule: how to go on.
    """

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
