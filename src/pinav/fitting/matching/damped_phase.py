"""What phases of damped steps share: a state, and an end where steps gain little."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree

from pinav.fitting.matching.phases import AbstractPhase, Loss
from pinav.fitting.outcome import Outcome


class DampedState(eqx.Module):
    """Where a phase of damped steps stands.

    Attributes:
        damping: of the step taken last.
        slow: steps in a row that gained little.
        value: what the phase reports as its loss once it has ended.
        done: whether the phase has ended.
    """

    damping: Float[Array, ""]
    slow: Int[Array, ""]
    value: Float[Array, ""]
    done: Bool[Array, ""]

    @classmethod
    def begin(cls, damping: Float[Array, ""], value: Float[Array, ""]) -> "DampedState":
        """Before the first step."""
        return cls(damping, jnp.zeros((), int), value, jnp.zeros((), bool))


class AbstractDampedPhase(AbstractPhase):
    """A phase whose steps are damped, and which no longer moves once it has ended."""

    @abc.abstractmethod
    def take_step(
        self, problem: Any, params: PyTree, state: DampedState
    ) -> tuple[PyTree, DampedState, Float[Array, ""]]:
        """One step of a phase that has not ended, for a `Problem`; see `step`."""

    @property
    def side_by_side(self) -> bool:
        return False

    def step(
        self, loss: Loss, params: PyTree, state: DampedState
    ) -> tuple[PyTree, DampedState, Float[Array, ""]]:
        return jax.lax.cond(
            state.done,
            lambda: (params, state, state.value),
            lambda: self.take_step(loss, params, state),
        )

    def finish(self, loss: Loss, params: PyTree, state: DampedState) -> PyTree:
        return params

    def is_done(self, state: DampedState) -> Bool[Array, ""]:
        return state.done

    def outcome(self, state: DampedState) -> Int[Array, ""]:
        return jnp.asarray(Outcome.COMPLETED)
