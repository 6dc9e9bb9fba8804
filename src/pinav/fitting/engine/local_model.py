r"""A model as a function of one vector, its priors, and a fit near a point.

A prior is written as $\exp(-z(\theta)^2/2)$ with a standardised value $z$. In a sum of
squares whose residuals have the standard deviation $\sigma$ it is one more residual,
$\sigma z$. While $\sigma$ is estimated, its last estimate stands there: at convergence
the two agree. While the noise is estimated, a constant that the data pull $z$ standard
deviations away from its prior counts as one residual of that size.
"""

import abc
import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from pinav.arguments import on_device
from pinav.fitting.evidence.quadratic import Parameters, Quadratic
from pinav.fitting.matching.state import Trainable, split_trainable
from pinav.systems.priors import AbstractNumberPrior, Normal


class ParametricModel(eqx.Module):
    """A model as a function of the vector of its parameters.

    Attributes:
        static: the model without the leaves that are parameters.
        unravel: from the vector to those leaves.
    """

    static: PyTree
    unravel: Callable[[Float[Array, " parameter"]], PyTree] = eqx.field(static=True)

    def __call__(self, theta: Float[Array, " parameter"]) -> Any:
        """The model with these parameters."""
        return eqx.combine(self.unravel(theta), self.static)

    def at(self, theta: Float[np.ndarray, " parameter"]) -> Any:
        """The same outside of compiled functions, without a program for each leaf."""
        shapes, tree = jax.tree.flatten(jax.eval_shape(self.unravel, theta))
        ends = np.cumsum([shape.size for shape in shapes])
        parts = np.split(np.asarray(theta), ends[:-1])
        leaves = [
            on_device(part.reshape(shape.shape))
            # of no parameters there is one empty part and no leaf
            for part, shape in zip(parts, shapes, strict=False)
        ]
        return eqx.combine(jax.tree.unflatten(tree, leaves), self.static)


def ravel_model(
    model: Any, trainable: Trainable
) -> tuple[ParametricModel, Float[Array, " parameter"]]:
    """The model as a function of the selected leaves, and their values, in float64."""
    free, static = split_trainable(model, trainable, jnp.float64)
    _, unravel = eqx.filter_eval_shape(ravel_pytree, free)  # which compiles nothing
    theta = np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(free)])
    return ParametricModel(static, unravel), on_device(theta)


def known_model(model: Any) -> ParametricModel:
    """A model without parameters."""
    nothing, known = eqx.partition(model, lambda _: False)
    return ParametricModel(known, ravel_pytree(nothing)[1])


def selected_entries(
    parametric: ParametricModel, count: int, select: Callable[[Any], PyTree]
) -> Bool[np.ndarray, " parameter"]:
    """True for the entries of the parameter vector of a selection of leaves."""
    shapes = _shapes(parametric, count)
    marks = jax.tree.map(lambda leaf: np.zeros(leaf.shape, bool), shapes)
    leaves = jax.tree.leaves(select(marks))
    if leaves:
        ones = [np.ones_like(leaf) for leaf in leaves]
        marks = eqx.tree_at(lambda m: jax.tree.leaves(select(m)), marks, ones)
    flat = [np.ravel(leaf) for leaf in jax.tree.leaves(marks)]
    return np.concatenate(flat) if flat else np.zeros(0, bool)


def parameter_names(parametric: ParametricModel, count: int) -> tuple[str, ...]:
    """A name for every entry of the parameter vector: the path of its leaf."""
    names = []
    leaves = jax.tree_util.tree_leaves_with_path(_shapes(parametric, count))
    for path, leaf in leaves:
        name = jax.tree_util.keystr(path).lstrip(".")
        indices = np.ndindex(*leaf.shape) if leaf.shape else [None]
        names += [name if i is None else f"{name}{list(i)}" for i in indices]
    return tuple(names)


def _shapes(parametric: ParametricModel, count: int) -> PyTree:
    """Shapes of the leaves that are parameters; nothing is computed."""
    return jax.eval_shape(parametric.unravel, jax.ShapeDtypeStruct((count,), float))


ModelOfParameters = Callable[[Float[Array, " parameter"]], Any]
"""A `ParametricModel`, or one that the commands of a trajectory drive besides."""


class ConstantPriors(eqx.Module):
    """Priors of some entries of the parameter vector."""

    entries: tuple[int, ...] = eqx.field(static=True, default=())
    priors: tuple[AbstractNumberPrior, ...] = ()

    def add_to(self, quadratic: Quadratic, noise: float) -> Quadratic:
        """The sum of squares with one more residual for each prior.

        Args:
            noise: last estimate of the standard deviation of the residuals.
        """
        if not self.entries:
            return quadratic
        index = list(self.entries)
        values, slopes = self._standardise(quadratic.point)
        hessian, gradient = quadratic.hessian.copy(), quadratic.gradient.copy()
        hessian[index, index] += (noise * slopes) ** 2
        gradient[index] += noise**2 * slopes * values
        # The evidence takes every residual for one of the data, of density 1/sqrt(2 pi
        # sigma^2) at its peak; that of a prior has the height of the prior instead.
        height = sum(prior.log_height for prior in self.priors)
        volume = -2 * height - len(index) * np.log(2 * np.pi * noise**2)
        return dataclasses.replace(
            quadratic,
            hessian=hessian,
            gradient=gradient,
            squares=quadratic.squares + noise**2 * float(values @ values),
            num_free=quadratic.num_free + len(index),
            log_determinant=quadratic.log_determinant + float(volume),
        )

    def squares(self, theta: Parameters) -> float:
        """Sum of the squared standardised values."""
        return float(np.sum(self._standardise(theta)[0] ** 2))

    def half_gradient(self, theta: Parameters) -> Parameters:
        """Half the gradient of `squares`."""
        gradient = np.zeros(len(theta))
        values, slopes = self._standardise(theta)
        gradient[list(self.entries)] = slopes * values
        return gradient

    def curvature(self, theta: Parameters) -> Parameters:
        """Half the second derivative of `squares`, less that of the values."""
        curvature = np.zeros(len(theta))
        curvature[list(self.entries)] = self._standardise(theta)[1] ** 2
        return curvature

    def _standardise(
        self, theta: Parameters
    ) -> tuple[Float[np.ndarray, " prior"], Float[np.ndarray, " prior"]]:
        """Standardised values, and their derivatives."""
        if not self.entries:
            return np.zeros(0), np.zeros(0)
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
        leaves: picks the leaves of a model.
        scales: of each leaf, the deviation of all of its numbers.
    """
    priors: dict[int, Normal] = {}
    for index, scale in enumerate(scales):
        chosen = selected_entries(
            parametric, len(theta), lambda model, index=index: leaves(model)[index]
        )
        for entry in np.flatnonzero(chosen).tolist():
            priors[entry] = Normal(float(theta[entry]), scale)
    return ConstantPriors(tuple(priors), tuple(priors.values()))


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
