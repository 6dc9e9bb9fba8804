r"""How a lifted fit moves from one linearisation to the next.

Kernels are linear in their weights: the full step to the mean of the posterior is
right. Networks and parametric forces are not, and move by damped steps whose damping
is chosen by what the parameters explain in truth.
"""

import abc
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float

from pinav.dynamics import FixedStep
from pinav.fitting.engine.multiple_shooting import (
    Linearisation,
    ParametricModel,
    Prediction,
    advanced,
    predict,
    pull_back,
)
from pinav.fitting.matching.objectives import Observations

CHORD_STEPS = 4
"""Steps with the Jacobian held, for each damping."""

EXPONENTS = range(-3, 2)
"""Dampings tried, as powers of ten of the last one."""


class AbstractLocalModel(eqx.Module):
    r"""A fit near one point.

    $|r|^2/\sigma^2 + \sum_i p_i \theta_i^2 + E(\theta)$ is minimised.

    Attributes:
        theta: the parameters.
        precision: $p$, of the prior; zero for a flat one.
        noise: $\sigma$.
        energy: $E$, what the prior says beyond the precision.
    """

    theta: eqx.AbstractVar[Float[np.ndarray, " parameter"]]
    precision: eqx.AbstractVar[Float[np.ndarray, " parameter"]]
    noise: eqx.AbstractVar[float]
    energy: eqx.AbstractVar[Callable[[Float[np.ndarray, " parameter"]], float]]

    @property
    @abc.abstractmethod
    def hessian(self) -> Float[np.ndarray, "parameter parameter"]:
        r"""$J^\top J$ of the residuals at this point."""

    @abc.abstractmethod
    def predict(self, theta: Float[np.ndarray, " parameter"]) -> Prediction:
        """Residuals for other parameters, and about which states to linearise there."""

    @abc.abstractmethod
    def pull_back(
        self, residuals: Float[Array, "..."]
    ) -> Float[np.ndarray, " parameter"]:
        r"""$J^\top r$, with the Jacobian of this point."""

    @abc.abstractmethod
    def advanced(
        self, mean: Float[np.ndarray, " parameter"]
    ) -> Float[Array, "trajectory time state"]:
        """States about which to linearise after a full step to `mean`."""

    @abc.abstractmethod
    def damping_scale(
        self, hessian: Float[np.ndarray, "parameter parameter"]
    ) -> Float[np.ndarray, " parameter"]:
        """What the damping of each parameter is relative to.

        Args:
            hessian: of the cost.
        """

    def cost(self, theta, residuals) -> float:
        """What is minimised; infinite where the residuals are not finite."""
        squares = float(jnp.sum(residuals**2)) / self.noise**2
        cost = squares + float(self.precision @ theta**2) + self.energy(theta)
        return cost if np.isfinite(cost) else np.inf

    def half_gradient(self, theta, residuals):
        """Half the gradient of the cost, with the Jacobian of this point."""
        return self.pull_back(residuals) / self.noise**2 + self.precision * theta


class Local(AbstractLocalModel):
    """A lifted fit of trajectories near one point.

    Attributes:
        free: the model as a function of its parameters.
        observations: the data.
        solver: steps between samples.
        theta: the parameters.
        states: about which the dynamics are linearised.
        linear: the linearisation.
        precision: of the prior.
        noise: standard deviation of the observations.
        energy: what the prior says beyond the precision.
    """

    free: ParametricModel
    observations: Observations
    solver: FixedStep
    theta: Float[np.ndarray, " parameter"]
    states: Float[Array, "trajectory time state"]
    linear: Linearisation
    precision: Float[np.ndarray, " parameter"]
    noise: float
    energy: Callable[[Float[np.ndarray, " parameter"]], float]

    @property
    def hessian(self):
        return np.asarray(self.linear.hessian)

    def predict(self, theta):
        return predict(
            self.free, jnp.asarray(theta), self.states, self.observations, self.solver
        )

    def pull_back(self, residuals):
        return np.asarray(pull_back(self.linear, residuals))

    def damping_scale(self, hessian):
        return self.precision if np.any(self.precision) else np.diag(hessian)

    def advanced(self, mean):
        return advanced(self.states, self.linear, jnp.asarray(mean - self.theta))


class Move(eqx.Module):
    """Where a step leads.

    Attributes:
        theta: the parameters.
        states: about which to linearise next.
        descent: how to go on.
    """

    theta: Float[np.ndarray, " parameter"]
    states: Float[Array, "trajectory time state"]
    descent: "AbstractStepRule"


class AbstractStepRule(eqx.Module):
    """Chooses the next point of linearisation."""

    @abc.abstractmethod
    def __call__(
        self, local: AbstractLocalModel, mean: Float[np.ndarray, " parameter"]
    ) -> Move:
        """The next point, given the `mean` of the linear model's posterior."""


class FullStep(AbstractStepRule):
    """To the mean of the posterior: right for a model linear in its parameters."""

    def __call__(self, local, mean):
        return Move(mean, local.advanced(mean), self)


class ShortenedStep(AbstractStepRule):
    """To the mean of the posterior, or as far towards it as lowers the true cost.

    For a model that is nearly linear, because it starts close to its best fit.
    """

    def __call__(self, local, mean):
        change = mean - local.theta
        here = local.predict(local.theta)
        before = local.cost(local.theta, here.residuals)
        for power in range(HALVINGS):
            theta = local.theta + 0.5**power * change
            found = local.predict(theta)
            if local.cost(theta, found.residuals) < before:
                return Move(theta, found.states, self)
        return Move(local.theta, here.states, self)


HALVINGS = 8
"""Lengths tried at most."""


class ChordSteps(AbstractStepRule):
    r"""Damped steps with the true residuals and the Jacobian held.

    For several dampings $\lambda$ and $P$, the Hessian of the cost, a few times
    $d \leftarrow d - (P + \lambda D)^{-1}(g(\theta + d) + \lambda D d)$, with the
    gradient $g$ of the true residuals. $D$ is `damping_scale`: for trajectories the
    precision of the prior, or the diagonal of $P$ where all priors are flat. Among all,
    the smallest damping wins that gains at least half as much as the best: the greedy
    choice creeps.

    Attributes:
        damping: the last one that won.

    References:
        Levenberg 1944; Marquardt 1963.
    """

    damping: float

    def __call__(self, local, mean):
        hessian = local.hessian / local.noise**2 + np.diag(local.precision)
        scale = local.damping_scale(hessian)
        here = local.predict(local.theta)
        before = local.cost(local.theta, here.residuals)
        dampings = [self.damping * 10.0**power for power in EXPONENTS]
        found = [
            _chord(local, hessian, damping * scale, here.residuals)
            for damping in dampings
        ]
        gains = before - np.array([cost for _, cost in found])
        if not gains.max() > 0:
            return Move(local.theta, here.states, ChordSteps(100 * self.damping))
        chosen = int(np.argmax(gains >= 0.5 * gains.max()))
        theta = found[chosen][0]
        descent = ChordSteps(max(dampings[chosen], LEAST_DAMPING))
        return Move(theta, local.predict(theta).states, descent)


LEAST_DAMPING = 1e-6
"""Below this a damping changes nothing."""


def _chord(local, hessian, damping, residuals):
    """Best parameters for one damping, and their cost."""
    try:
        factor = scipy.linalg.cho_factor(hessian + np.diag(damping))
    except scipy.linalg.LinAlgError:
        return local.theta, np.inf
    theta, best, lowest = local.theta, local.theta, np.inf
    for _ in range(CHORD_STEPS):
        pull = local.half_gradient(theta, residuals)
        pull = pull + damping * (theta - local.theta)
        theta = theta - scipy.linalg.cho_solve(factor, pull)
        residuals = local.predict(theta).residuals
        cost = local.cost(theta, residuals)
        if not cost < np.inf:
            break
        if cost < lowest:
            best, lowest = theta, cost
    return best, lowest
