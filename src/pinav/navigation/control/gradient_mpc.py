r"""Model-predictive control by shooting: descent on the gradient through the model.

References:
    Kingma and Ba, ICLR 2015, for the steps.
"""

from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from pinav.arguments import check_positive
from pinav.navigation.control.controller import (
    AbstractController,
    Controls,
    Observation,
)
from pinav.navigation.control.costs import AbstractCost
from pinav.navigation.control.prediction import AbstractGuide, TrajectoryPrediction
from pinav.navigation.model.predictors import within_ball
from pinav.navigation.task.steering import Command, direction

_Descent = tuple[Controls, optax.OptState, Controls, Float[Array, ""]]
"""Controls, moments of Adam's steps, the best controls so far, and their cost."""


class GradientMPC(AbstractController[Controls]):
    r"""Improves sequences of thrusts by steps along the gradient of their cost.

    Each sequence that is kept, and that of the guide, takes Adam's steps whose length
    falls to nothing, is brought back to the allowed thrust after each, and the best one
    met is the answer. Kept sequences are moved on by one from step to step.

    Attributes:
        prediction: what follows from a sequence, and the steps it has.
        cost: of a course; differentiable almost everywhere.
        guide: proposes a further sequence in each step, or None.
        iterations: steps of descent, positive.
        rate: length of the first step, where 1 is the greatest thrust, positive.

    Raises:
        InputError: `iterations` or `rate` is not positive.
    """

    prediction: TrajectoryPrediction
    cost: AbstractCost
    guide: AbstractGuide | None = None
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
        guesses = jnp.concatenate([memory[1:], memory[-1:]])[None]
        if self.guide is not None:
            guided = self.guide(observation, self.prediction)
            guesses = jnp.concatenate([guesses, guided[None]])
        solutions, costs = jax.vmap(lambda one: self._descend(observation, one))(
            guesses
        )
        best = solutions[jnp.argmin(costs)]
        return self.prediction.command(observation, best[0]), best

    def _descend(
        self, observation: Observation, controls: Controls
    ) -> tuple[Controls, Float[Array, ""]]:
        """The best sequence met on the way down, and its cost."""

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
        (last, _, best, least), _ = jax.lax.scan(
            descend, begin, self._lengths(controls)
        )
        final = cost(last)
        return jnp.where(final < least, last, best), jnp.minimum(final, least)

    def _lengths(self, controls: Controls) -> Float[Array, " iteration"]:
        """Lengths of the steps of descent: half a cosine, from the rate to zero."""
        done = jnp.arange(self.iterations, dtype=controls.dtype) / self.iterations
        return self.rate * (1 + jnp.cos(jnp.pi * done)) / 2


SMALL = 0.1
"""Size of the first controls: the heading of no thrust has no derivative."""
