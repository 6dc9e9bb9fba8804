"""The Laplace posterior of a fit: models drawn from it, and linear rollouts."""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PRNGKeyArray

from pinav.arguments import Scalar, State, Vector, on_device
from pinav.dynamics import FixedStep
from pinav.fitting.engine.local_model import ModelOfParameters, ParametricModel
from pinav.fitting.engine.multiple_shooting import sensitivities
from pinav.fitting.engine.unvisited import AbstractDoubt, doubts
from pinav.fitting.evidence.quadratic import Parameters
from pinav.forces import AbstractForce, SumForce, as_learned_force


class Estimate(eqx.Module):
    """A learned number.

    Attributes:
        sd: its standard deviation; NaN without a posterior.
        unit: of both; "?" where it is not known.
    """

    DERIVED = ("low", "high")

    value: float
    sd: float
    unit: str = eqx.field(static=True, default="?")

    @property
    def low(self) -> float:
        """Lower end of its 95 % interval."""
        return self.value - TWO_SIDED * self.sd

    @property
    def high(self) -> float:
        """Upper end of its 95 % interval."""
        return self.value + TWO_SIDED * self.sd


TWO_SIDED = 1.959963984540054
"""Standard deviations from the middle of a normal distribution to 97.5 %."""


class Posterior(eqx.Module):
    """Normal distribution of the free parameters about their best values.

    Attributes:
        free: the model as a function of them.
        mean: their best values.
        covariance: their covariance, given the chosen hyperparameters.
        visited: observed positions [L], beyond which the force is unknown; None where
            its form is known everywhere.
    """

    free: ParametricModel
    mean: Parameters
    covariance: Float[np.ndarray, "parameter parameter"]
    visited: Float[np.ndarray, "place dim"] | None = None

    @property
    def model(self) -> Any:
        """The model with the best parameters."""
        with jax.enable_x64(new_val=True):
            return self.free.at(self.mean)

    def draws(self, count: int, *, key: PRNGKeyArray) -> Float[Array, "draw parameter"]:
        """Parameters drawn from the posterior, one vector a row."""
        eigenvalues, vectors = np.linalg.eigh(self.covariance)
        # A posterior of many weights is singular to rounding, where Cholesky fails.
        root = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
        with jax.enable_x64(new_val=True):
            normal = _normal(key, (count, len(self.mean)))
            return on_device(self.mean[None] + np.asarray(normal) @ root.T)

    def samples(self, count: int, *, key: PRNGKeyArray) -> list[Any]:
        """Models drawn from the posterior.

        On unvisited ground their forces differ as `force_sd` says.
        """
        draws = self.draws(count, key=key)
        generator = np.random.default_rng(np.asarray(jax.random.key_data(key)))
        with jax.enable_x64(new_val=True):
            return [self._with_doubt(self.free(theta), generator) for theta in draws]

    def force_sd(
        self, positions: ArrayLike | Sequence, time: float = 0.0
    ) -> Float[np.ndarray, "point dim"]:
        """Standard deviation of the environment's force [L T⁻²] on a swimmer at rest.

        A band of 1.96 of them has a nominal probability of 95 %. On unvisited ground
        the force is as uncertain as it is large on visited ground; see `unvisited`.

        Args:
            positions: points, one a row [L].
            time: at which the force acts [T].
        """
        known = _spread(self.force_jacobians(positions, time), self.covariance)
        with jax.enable_x64(new_val=True):
            points = np.asarray(positions, float)
            unknown = [doubt.variance(points) for doubt in self._doubts]
        return np.sqrt(known**2 + sum(unknown, np.zeros_like(known)))

    @functools.cached_property
    def _doubts(self) -> tuple[AbstractDoubt, ...]:
        """The doubts that visited ground leaves of other ground, part by part."""
        if self.visited is None:
            return ()
        force = as_learned_force(self.model.environment)
        if force is None:
            return ()
        return tuple(doubts(force, self.visited, self._part_variance))

    def _part_variance(
        self,
        part: Callable[[Any], AbstractForce],
        places: Float[np.ndarray, "place dim"],
    ) -> Float[np.ndarray, "place dim"]:
        """Variance of each component of a part of the force."""
        points, times = on_device(places), jnp.zeros(len(places))
        mean = on_device(self.mean)
        slopes = np.asarray(force_jacobians(self.free, mean, points, times, part))
        return _spread(slopes, self.covariance) ** 2

    def _with_doubt(self, model: Any, generator: np.random.Generator) -> Any:
        """A model whose force is drawn on unvisited ground, too."""
        drawn = tuple(doubt.draw(generator) for doubt in self._doubts)
        if not drawn:
            return model
        return model.with_environment(SumForce((model.environment, *drawn)))

    def force_jacobians(
        self, positions: ArrayLike | Sequence, time: float = 0.0
    ) -> Float[np.ndarray, "point dim parameter"]:
        """Derivatives of the environment's force on a swimmer at rest by parameters."""
        with jax.enable_x64(new_val=True):
            points = jnp.asarray(positions, jnp.float64)
            times = jnp.full(len(points), time, jnp.float64)
            mean = on_device(self.mean)
            return np.asarray(force_jacobians(self.free, mean, points, times))


@eqx.filter_jit
def force_jacobians(
    free: ParametricModel,
    theta: Float[Array, " parameter"],
    points: Float[Array, "point dim"],
    times: Float[Array, " point"],
    part: Callable[[Any], AbstractForce] = lambda force: force,
) -> Float[Array, "point dim parameter"]:
    """Derivatives of the environment's force at rest, or of a part of it."""

    def force(theta: Float[Array, " parameter"], x: Vector, t: Scalar) -> Vector:
        return part(free(theta).environment)(t, x, jnp.zeros_like(x))

    return jax.vmap(jax.jacrev(force), (None, 0, 0))(theta, points, times)


@eqx.filter_jit
def linear_rollout(
    free: ModelOfParameters,
    theta: Float[Array, " parameter"],
    y0: State,
    ts: Float[Array, " time"],
    solver: FixedStep,
) -> tuple[Float[Array, "time state"], Float[Array, "time state column"]]:
    """States of a rollout, and their derivatives as `Sensitivities` have them."""
    ys, _ = solver.solve(free(theta), y0, ts)
    return ys, sensitivities(free, theta, ys, ts, solver).columns


def _spread(
    jacobians: Float[np.ndarray, "*place parameter"],
    covariance: Float[np.ndarray, "parameter parameter"],
) -> Float[np.ndarray, "*place"]:
    """Standard deviations of linear functions of the parameters."""
    # one large product: numpy multiplies a stack of small matrices one by one
    *places, count = jacobians.shape
    rows = jacobians.reshape(math.prod(places), count)
    variance = np.sum((rows @ covariance) * rows, axis=-1)
    return np.sqrt(np.maximum(variance, 0.0)).reshape(places)


@eqx.filter_jit
def _normal(key: PRNGKeyArray, shape: tuple[int, int]) -> Float[Array, "draw number"]:
    """Independent standard normal numbers."""
    return jax.random.normal(key, shape, jnp.float64)
