r"""Priors of learned constants, as observations of the constants themselves.

A prior is written as $\exp(-z(\theta)^2/2)$ with a standardised value $z$. In a sum of
squares whose residuals have the standard deviation $\sigma$ it is one more residual,
$\sigma z$. While $\sigma$ is estimated, its last estimate stands there: at convergence
the two agree. While the noise is estimated, a constant that the data pull $z$ standard
deviations away from its prior counts as one residual of that size.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from pinav.arguments import on_device
from pinav.fitting.engine.parametric_model import ParametricModel, selected_entries
from pinav.fitting.evidence.quadratic import Parameters, Quadratic
from pinav.systems.priors import AbstractNumberPrior, Normal


class ConstantPriors(eqx.Module):
    """Priors of some entries of the parameter vector.

    Attributes:
        entries: which entries have one.
        priors: of each of them.
    """

    entries: tuple[int, ...] = eqx.field(static=True, default=())
    priors: tuple[AbstractNumberPrior, ...] = ()

    def add_to(self, quadratic: Quadratic, noise: float) -> Quadratic:
        """The sum of squares with one more residual for each prior.

        Args:
            quadratic: the sum of squares of the data.
            noise: last estimate of the standard deviation of the residuals.
        """
        if not self.entries:
            return quadratic
        index, (values, slopes) = (
            list(self.entries),
            self._standardise(quadratic.point),
        )
        hessian, gradient = quadratic.hessian.copy(), quadratic.gradient.copy()
        hessian[index, index] += (noise * slopes) ** 2
        gradient[index] += noise**2 * slopes * values
        # The evidence takes every residual for one of the data, of density 1/sqrt(2 pi
        # sigma^2) at its peak; that of a prior has the height of the prior instead.
        volume = -2 * self.log_height - len(index) * np.log(2 * np.pi * noise**2)
        return Quadratic(
            point=quadratic.point,
            hessian=hessian,
            gradient=gradient,
            squares=quadratic.squares + noise**2 * float(values @ values),
            num_free=quadratic.num_free + len(index),
            log_determinant=quadratic.log_determinant + float(volume),
        )

    @property
    def log_height(self) -> float:
        """Logarithm of the product of the densities at their peaks."""
        return float(sum(prior.log_height for prior in self.priors))

    def squares(self, theta: Parameters) -> float:
        """Sum of the squared standardised values."""
        return float(np.sum(self._standardise(theta)[0] ** 2)) if self.entries else 0.0

    def half_gradient(self, theta: Parameters) -> Parameters:
        """Half the gradient of `squares`."""
        gradient = np.zeros(len(theta))
        if self.entries:
            values, slopes = self._standardise(theta)
            gradient[list(self.entries)] = slopes * values
        return gradient

    def curvature(self, theta: Parameters) -> Parameters:
        """Half the second derivative of `squares`, less that of the values."""
        curvature = np.zeros(len(theta))
        if self.entries:
            curvature[list(self.entries)] = self._standardise(theta)[1] ** 2
        return curvature

    def _standardise(
        self, theta: Parameters
    ) -> tuple[Float[np.ndarray, " prior"], Float[np.ndarray, " prior"]]:
        """Standardised values, and their derivatives."""
        values, slopes = _scores(self.priors, on_device(theta[list(self.entries)]))
        return np.asarray(values), np.asarray(slopes)


def wide_priors(
    parametric: ParametricModel,
    theta: Parameters,
    leaves: Callable[[Any], Sequence[PyTree]],
    scales: Sequence[float],
) -> ConstantPriors:
    """Normal priors of some leaves about where a fit begins.

    Args:
        parametric: the model as a function of its parameters.
        theta: the parameters at which the fit begins.
        leaves: picks the leaves of a model.
        scales: of each leaf, the deviation of all of its numbers.
    """
    entries: list[int] = []
    priors: list[Normal] = []
    for index, scale in enumerate(scales):
        chosen = selected_entries(
            parametric, len(theta), lambda model, index=index: leaves(model)[index]
        )
        for entry in np.flatnonzero(chosen).tolist():
            entries.append(entry)
            priors.append(Normal(float(theta[entry]), scale))
    return ConstantPriors(tuple(entries), tuple(priors))


@eqx.filter_jit
def _scores(
    priors: tuple[AbstractNumberPrior, ...], values: Float[Array, " prior"]
) -> tuple[Float[Array, " prior"], Float[Array, " prior"]]:
    """The standardised value of each number, and its derivative."""
    pairs = [
        jax.value_and_grad(prior.standard_score)(value)
        for prior, value in zip(priors, values, strict=True)
    ]
    scores, slopes = zip(*pairs, strict=True)
    return jnp.stack(scores), jnp.stack(slopes)
