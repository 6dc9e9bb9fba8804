r"""Model-predictive control by path integrals.

References:
    Williams, Aldrich and Theodorou, J. Guid. Control Dyn. 40, 344 (2017).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from pinav.arguments import Scalar, check_positive
from pinav.errors import InputError
from pinav.navigation.control.controller import (
    AbstractController,
    AbstractCost,
    Controls,
    GradientGuide,
    Observation,
    TrajectoryPrediction,
)
from pinav.navigation.predictors import within_ball
from pinav.navigation.task.steering import Command


class PathIntegral(AbstractController[Controls]):
    r"""Improves a sequence of thrusts by a weighted mean of random changes of it.

    The weights are $\exp(-(J - J_{min}) / \lambda)$; $\lambda$ is `temperature` times
    the distance of the median cost from the least one, so that it needs no unit. The
    changes are linear between knots, as wide as `spread` and half as wide in each
    further round. The sequence is kept from step to step, moved on by one; in the first
    round half of the changes are of the guide's sequence, so that a warm start is not a
    trap.

    Attributes:
        guide: proposes a further sequence in each step, or None.
        samples: random sequences in each round, at least 2.
        rounds: of improvement in a step, positive.
        spread: standard deviation of the changes in the first round, where 1 is the
            greatest thrust.
        temperature: of the weights, positive.

    Raises:
        InputError: `samples`, `rounds`, `spread` or `temperature` is too small.
    """

    prediction: TrajectoryPrediction
    cost: AbstractCost
    guide: GradientGuide | None = None
    samples: int = eqx.field(static=True, default=96)
    rounds: int = eqx.field(static=True, default=2)
    spread: float = 0.6
    temperature: float = 0.05

    def __check_init__(self) -> None:
        for name, least in (("samples", 2), ("rounds", 1)):
            if getattr(self, name) < least:
                raise InputError(
                    f"PathIntegral.{name}: expected >= {least}, got "
                    f"{getattr(self, name)}"
                )
        check_positive(self, "spread", "temperature")

    def start(self, observation: Observation) -> Controls:
        dim = self.prediction.control_map.dim
        return jnp.zeros((self.prediction.steps, dim), observation.state.dtype)

    def __call__(
        self, observation: Observation, memory: Controls, *, key: PRNGKeyArray
    ) -> tuple[Command, Controls]:
        nominal = jnp.concatenate([memory[1:], memory[-1:]])
        other = nominal
        if self.guide is not None:
            other = self.guide(observation, self.prediction)

        def improve(
            centers: Float[Array, "2 step dim"],
            inputs: tuple[Float[Array, ""], PRNGKeyArray],
        ) -> tuple[Float[Array, "2 step dim"], None]:
            better = self._improve(observation, centers, *inputs)
            return jnp.stack([better, better]), None

        widths = self.spread * 0.5 ** jnp.arange(float(self.rounds))
        keys = jax.random.split(key, self.rounds)
        centers = jnp.stack([nominal, other.astype(nominal.dtype)])
        centers, _ = jax.lax.scan(improve, centers, (widths, keys))
        return self.prediction.command(observation, centers[0, 0]), centers[0]

    def _improve(
        self,
        observation: Observation,
        centers: Float[Array, "2 step dim"],
        width: Scalar,
        key: PRNGKeyArray,
    ) -> Controls:
        """Mean of the two centres and of changes of either, by the weights."""
        changes = width * self._changes(key).astype(centers.dtype)
        around = centers[jnp.arange(self.samples) % 2] + changes
        tried = jnp.concatenate([centers, BEYOND * within_ball(around / BEYOND)])
        costs = self._costs(observation, tried)
        least = jnp.min(costs)
        unit = self.temperature * (jnp.median(costs) - least) + 1e-9
        weights = jax.nn.softmax(-(costs - least) / unit)
        return jnp.tensordot(weights, tried, 1)

    def _costs(
        self, observation: Observation, many: Float[Array, "sample step dim"]
    ) -> Float[Array, " sample"]:
        ts, ys = jax.vmap(lambda controls: self.prediction(observation, controls))(many)
        costs = jax.vmap(self.cost)(ts, ys, many)
        # Finite, so that the median and the differences below remain numbers.
        return jnp.where(jnp.isfinite(costs), costs, jnp.finfo(costs.dtype).max / 4)

    def _changes(self, key: PRNGKeyArray) -> Float[Array, "sample step dim"]:
        """Random sequences of unit size, linear between their knots."""
        steps = self.prediction.steps
        knots = max(2, -(-steps // STEPS_PER_KNOT) + 1)
        values = jax.random.normal(
            key, (self.samples, knots, self.prediction.control_map.dim)
        )
        place = jnp.linspace(0.0, knots - 1.0, steps)
        hats = jnp.maximum(
            0.0, 1 - jnp.abs(place[:, None] - jnp.arange(float(knots))[None])
        )
        return jnp.einsum("tk,skc->stc", hats, values)


STEPS_PER_KNOT = 4
"""Steps between the knots of a random change."""

BEYOND = 1.5
"""Length of the longest controls. Any beyond 1 gives the greatest thrust: where that is
best, means of shorter ones would fall short of it."""
