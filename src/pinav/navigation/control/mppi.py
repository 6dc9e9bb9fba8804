r"""Model-predictive control: path integrals, and descent on the gradient.

References:
    Williams, Aldrich and Theodorou, J. Guid. Control Dyn. 40, 344 (2017).

References:
    Kingma and Ba, ICLR 2015, for the steps.
"""

from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
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
from pinav.navigation.task.steering import Command, direction


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


_Descent = tuple[Controls, optax.OptState, Controls, Float[Array, ""]]
"""Controls, moments of Adam's steps, the best controls so far, and their cost."""


class GradientMPC(AbstractController[Controls]):
    r"""Improves a sequence of thrusts by steps along the gradient of its cost.

    The sequence takes Adam's steps whose length falls to nothing, is brought back to
    the allowed thrust after each, and the best one met is the answer. It is kept, and
    moved on by one, from step to step.

    Attributes:
        cost: of a course; differentiable almost everywhere.
        iterations: steps of descent, positive.
        rate: length of the first step, where 1 is the greatest thrust, positive.

    Raises:
        InputError: `iterations` or `rate` is not positive.
    """

    prediction: TrajectoryPrediction
    cost: AbstractCost
    iterations: int = eqx.field(static=True, default=20)
    rate: float = 0.15

    def __check_init__(self) -> None:
        check_positive(self, "iterations", "rate")

    def start(self, observation: Observation) -> Controls:
        ahead = SMALL * direction(observation.pending[-1, 1:])
        return jnp.tile(
            ahead.astype(observation.state.dtype), (self.prediction.steps, 1)
        )

    def __call__(
        self, observation: Observation, memory: Controls, *, key: PRNGKeyArray
    ) -> tuple[Command, Controls]:
        del key
        best = self._descend(observation, jnp.concatenate([memory[1:], memory[-1:]]))
        return self.prediction.command(observation, best[0]), best

    def _descend(self, observation: Observation, controls: Controls) -> Controls:
        """The best sequence met on the way down."""

        def cost(controls: Controls) -> Float[Array, ""]:
            value = self.cost(*self.prediction(observation, controls), controls)
            return jnp.where(jnp.isfinite(value), value, jnp.inf)

        method = optax.scale_by_adam()

        def descend(carry: _Descent, length: Float[Array, ""]) -> tuple[_Descent, None]:
            controls, progress, best, least = carry
            value, slope = jax.value_and_grad(cost)(controls)
            better = value < least
            best = jnp.where(better, controls, best)
            least = jnp.where(better, value, least)
            # One step of a lost rollout must not poison Adam's moments for all others.
            slope = jnp.where(jnp.isfinite(slope), slope, 0.0)
            with jax.numpy_dtype_promotion("standard"):  # as optax expects
                change, progress = method.update(slope, progress)
            controls = within_ball(controls - length * cast(Array, change))
            return (controls, progress, best, least), None

        least = jnp.asarray(jnp.inf, controls.dtype)
        begin = (controls, method.init(controls), controls, least)
        # Lengths of the steps are half a cosine, from the rate to zero.
        done = jnp.arange(self.iterations, dtype=controls.dtype) / self.iterations
        lengths = self.rate * (1 + jnp.cos(jnp.pi * done)) / 2
        (last, _, best, least), _ = jax.lax.scan(descend, begin, lengths)
        return jnp.where(cost(last) < least, last, best)


SMALL = 0.1
"""Size of the first controls: the heading of no thrust has no derivative."""
