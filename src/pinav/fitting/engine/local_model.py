"""A fit near one point, and what is minimised there."""

import abc
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.fitting.engine.constant_priors import ConstantPriors
from pinav.fitting.evidence.quadratic import Parameters, Quadratic

States = Float[Array, "trajectory time state"] | None
"""States about which dynamics are linearised; None where there are no dynamics."""


class Prediction(eqx.Module):
    """What a parameter vector explains.

    Attributes:
        residuals: predicted less observed; zero where nothing was observed.
        states: about which to linearise there.
    """

    residuals: Float[Array, "..."]
    states: States


class AbstractLocalModel(eqx.Module):
    """Residuals as a function of the parameters, linearised about one point.

    Attributes:
        quadratic: the sum of their squares, about the parameters there.
    """

    quadratic: eqx.AbstractVar[Quadratic]

    @property
    def theta(self) -> Parameters:
        """The parameters of that point."""
        return self.quadratic.point

    @abc.abstractmethod
    def predict(self, theta: Parameters) -> Prediction:
        """True residuals for other parameters."""

    @abc.abstractmethod
    def pull_back(self, residuals: Float[Array, "..."]) -> Parameters:
        r"""$J^\top r$, with the Jacobian of this point."""

    @abc.abstractmethod
    def advance(self, mean: Parameters) -> States:
        """States about which to linearise after a full step to `mean`."""

    @abc.abstractmethod
    def defect(self, mean: Parameters, noise: float) -> float:
        """Distance from a solution, on the scale of `DEFECT_TOLERANCE`.

        Args:
            mean: parameters that the linear model asks for.
        """


class PenalisedSquares(eqx.Module):
    r"""The cost near a point: $|r|^2/\sigma^2 + \sum_i p_i \theta_i^2 + E(\theta)$.

    Attributes:
        precision: $p$, of the prior; zero for a flat one.
        noise: $\sigma$.
        energy: what the prior of the weights says beyond the precision.
        priors: of the constants; with `energy` they make $E$.
    """

    local: AbstractLocalModel
    precision: Parameters
    noise: float
    energy: Callable[[Parameters], float]
    priors: ConstantPriors

    @property
    def hessian(self) -> Float[np.ndarray, "parameter parameter"]:
        """Half the Hessian of the cost, in the approximation of Gauss and Newton."""
        diagonal = self.precision + self.priors.curvature(self.local.theta)
        return self.local.quadratic.hessian / self.noise**2 + np.diag(diagonal)

    def cost(self, theta: Parameters, residuals: Float[Array, "..."]) -> float:
        """What is minimised; infinite where the residuals are not finite."""
        squares = float(jnp.sum(residuals**2)) / self.noise**2
        prior = float(self.precision @ theta**2) + self.energy(theta)
        cost = squares + prior + self.priors.squares(theta)
        # NaN compares false with everything: as infinity a step to it is refused.
        return cost if np.isfinite(cost) else np.inf

    def half_gradient(
        self, theta: Parameters, residuals: Float[Array, "..."]
    ) -> Parameters:
        """Half the gradient of the cost, with the Jacobian of the local model."""
        pull = self.local.pull_back(residuals) / self.noise**2
        return pull + self.precision * theta + self.priors.half_gradient(theta)
