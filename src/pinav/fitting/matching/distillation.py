"""Regression of a model on rates of change, before its first rollout."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from pinav.errors import InputError
from pinav.fitting.matching.damped_phase import AbstractDampedPhase, DampedState
from pinav.fitting.matching.gauss_newton import damped_step


class Rates(eqx.Module):
    """Rates of change of states.

    Attributes:
        times: of each state [T].
        states: the states.
        rates: of change of the last channels; of a swimmer's velocity alone.
    """

    times: Float[np.ndarray, " point"]
    states: Float[np.ndarray, "point state"]
    rates: Float[np.ndarray, "point channel"]


def _on_device(rates: Rates) -> Rates:
    return jax.tree.map(jnp.asarray, rates)


class Distillation(AbstractDampedPhase):
    """Damped Gauss-Newton steps on rates of change, which need no rollout.

    Rollouts of a random network depart from the data after a few samples, and those of
    one that was matched sample by sample may, because nothing tells it the force
    beside the path. A network distilled from a force that is known there follows the
    data at once.

    Attributes:
        targets: the rates.
        steps: number of steps at most.
        rank: columns of the random projection.
        patience: steps in a row that gain less than a fiftieth, after which it ends.

    Raises:
        InputError: `steps` is not positive.
    """

    targets: Rates = eqx.field(converter=_on_device)
    steps: int = eqx.field(static=True, default=40)
    rank: int = eqx.field(static=True, default=192)
    patience: int = eqx.field(static=True, default=5)

    def __check_init__(self):
        if self.steps < 1:
            raise InputError(f"Distillation.steps: expected >= 1, got {self.steps}")

    @property
    def name(self):
        return "Distillation"

    @property
    def num_steps(self):
        return self.steps

    @property
    def chunk_steps(self):
        return 5

    def init(self, loss, params, value):
        damping = jnp.asarray(DAMPING, value.dtype)
        return DampedState.begin(damping, value)

    def take_step(self, problem, params, state):
        theta, unravel = ravel_pytree(params)

        targets = self.targets.rates
        size = jnp.sqrt(jnp.mean(targets**2))
        size = jnp.where(size > 0, size, 1.0)

        def rate(theta, t, y):
            rates = problem.model(unravel(theta))(t, y)
            return rates[-targets.shape[1] :] / size

        def residuals(theta):
            computed = jax.vmap(rate, (None, 0, 0))(
                theta, self.targets.times, self.targets.states
            )
            return (computed - targets / size).reshape(-1)

        jacobian = jax.vmap(jax.jacrev(rate), (None, 0, 0))(
            theta, self.targets.times, self.targets.states
        ).reshape(-1, theta.shape[0])
        step = damped_step(
            residuals,
            theta,
            (residuals(theta), jacobian),
            state.damping,
            rank=self.rank,
            num_dampings=5,
            chord_steps=5,
        )
        slow = jnp.where(step.left < 0.96, 0, state.slow + 1)
        error = jnp.sqrt(jnp.mean(residuals(step.theta) ** 2))
        done = (slow >= self.patience) | (error < DISTILLED)
        state = DampedState(step.damping, slow, state.value, done)
        return unravel(step.theta), state, state.value


DAMPING = 1e3
"""Of the first step: with less, a third of the networks saturate and learn no more."""

DISTILLED = 1e-2
"""Relative error of the rates at which rollouts tell more."""
