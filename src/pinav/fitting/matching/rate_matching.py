"""Regression of a model on rates of change, before its first rollout."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike, Float, Int, PyTree

from pinav.errors import InputError
from pinav.fitting.matching.damped_phase import AbstractDampedPhase, DampedState
from pinav.fitting.matching.defects import full_step
from pinav.fitting.matching.phases import Loss
from pinav.fitting.outcome import Outcome


class Rates(eqx.Module):
    """Rates of change of states.

    Attributes:
        times: of each state [T].
        states: the states.
        rates: of change of the last channels; of a swimmer's velocity alone.
        doubts: estimated error of all rates of a state, where it is known.
    """

    times: Float[np.ndarray, " point"]
    states: Float[np.ndarray, "point state"]
    rates: Float[np.ndarray, "point channel"]
    doubts: Float[np.ndarray, " point"] | None = None


def _on_device(rates: Rates) -> Rates:
    return jax.tree.map(jnp.asarray, rates)


class RateMatching(AbstractDampedPhase):
    """Damped Gauss-Newton steps on rates of change, which need no rollout.

    Rollouts of a random network depart from the data after a few samples. Its rates
    at observed states are functions of the parameters alone, without a solver, and
    steps with the whole Jacobian learn them to some millionths.

    Attributes:
        targets: the rates.
        steps: number of steps at most.
        patience: steps in a row that gain less than a tenth, after which it ends.

    Raises:
        InputError: `steps` is not positive.
    """

    targets: Rates = eqx.field(converter=_on_device)
    steps: int = eqx.field(static=True, default=40)
    patience: int = eqx.field(static=True, default=3)

    def __check_init__(self) -> None:
        if self.steps < 1:
            raise InputError(f"RateMatching.steps: expected >= 1, got {self.steps}")

    @property
    def name(self) -> str:
        return "Rates"

    @property
    def num_steps(self) -> int:
        return self.steps

    @property
    def chunk_steps(self) -> int:
        return 5

    def init(self, loss: Loss, params: PyTree, value: Float[Array, ""]) -> DampedState:
        damping = jnp.asarray(DAMPING, value.dtype)
        return DampedState.begin(damping, value)

    def outcome(self, state: DampedState) -> Int[Array, ""]:
        return jnp.asarray(Outcome.COMPLETED)

    def take_step(
        self, problem: Any, params: PyTree, state: DampedState
    ) -> tuple[PyTree, DampedState]:
        theta, unravel = ravel_pytree(params)

        targets = self.targets.rates
        size = jnp.sqrt(jnp.mean(targets**2, axis=0))
        size = jnp.where(size > 0, size, 1.0)

        def rate(
            theta: Float[Array, " parameter"], t: ArrayLike, y: ArrayLike
        ) -> Float[Array, " channel"]:
            rates = problem.model(unravel(theta))(t, y)
            return rates[-targets.shape[1] :] / size

        def residuals(theta: Float[Array, " parameter"]) -> Float[Array, " residual"]:
            computed = jax.vmap(rate, (None, 0, 0))(
                theta, self.targets.times, self.targets.states
            )
            return (computed - targets / size[None]).reshape(-1)

        jacobian = jax.vmap(jax.jacrev(rate), (None, 0, 0))(
            theta, self.targets.times, self.targets.states
        ).reshape(-1, theta.shape[0])
        step = full_step(residuals, theta, (residuals(theta), jacobian), state.damping)
        slow = jnp.where(step.left < SLOW_RATES, 0, state.slow + 1)
        error = jnp.sqrt(jnp.mean(residuals(step.theta) ** 2))
        done = (slow >= self.patience) | (error < MATCHED)
        after = (step.damping, slow, done)
        state = eqx.tree_at(lambda s: (s.damping, s.slow, s.done), state, after)
        return unravel(step.theta), state


DAMPING = 1e3
"""Of the first step: with less, a third of the networks saturate and learn no more."""

SLOW_RATES = 0.95
"""Share of the squares that a slow step leaves: steps are cheap, and networks that see
the whole state gain a few per cent for twenty steps before they gain the rest."""

MATCHED = 1e-6
"""Relative error of the rates that needs no further step: splines are less exact."""
