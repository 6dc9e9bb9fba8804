"""What phases of damped steps share: a state, and an end where steps gain little."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, PyTree

from pinav.dynamics import FixedStep
from pinav.fitting.matching.phases import AbstractPhase, Loss
from pinav.fitting.matching.windows import Windows
from pinav.fitting.outcome import Outcome


class DampedStep(eqx.Module):
    """Where the best of several damped steps leads.

    Attributes:
        theta: the parameters; those before where no step lowers the squares.
        damping: of that step, or of the next one to try.
        left: share of the sum of squares that is left.
        promised: share of the squares that the linear model promised to save.
    """

    theta: Float[Array, " parameter"]
    damping: Float[Array, ""]
    left: Float[Array, ""]
    promised: Float[Array, ""]


class DampedState(eqx.Module):
    """Where a phase of damped steps stands.

    Attributes:
        damping: of the step taken last.
        slow: steps in a row that gained little.
        value: the loss that the phase reports.
        promised: share of the squares that the linear model promised to save.
        coloured: whether neighbouring residuals of the full rollout are alike.
        exact: whether the full rollout is good enough.
        done: whether the phase has ended.
    """

    damping: Float[Array, ""]
    slow: Int[Array, ""]
    value: Float[Array, ""]
    promised: Float[Array, ""]
    coloured: Bool[Array, ""]
    exact: Bool[Array, ""]
    done: Bool[Array, ""]

    @classmethod
    def begin(cls, damping: Float[Array, ""], value: Float[Array, ""]) -> "DampedState":
        """Before the first step."""
        none, yes = jnp.zeros((), int), jnp.ones((), bool)
        damping = damping.astype(value.dtype)
        return cls(damping, none, value, jnp.ones_like(value), yes, ~yes, ~yes)


class AbstractDampedPhase(AbstractPhase):
    """A phase whose steps are damped, and which no longer moves once it has ended."""

    @abc.abstractmethod
    def take_step(
        self, problem: Any, params: PyTree, state: DampedState
    ) -> tuple[PyTree, DampedState]:
        """Parameters and state after a step of a phase that has not ended.

        Args:
            problem: the `Problem` of the fit.
            params: the parameters that train.
            state: of the phase.
        """

    @property
    def side_by_side(self) -> bool:
        return False

    def step(
        self, loss: Loss, params: PyTree, state: DampedState
    ) -> tuple[PyTree, DampedState, Float[Array, ""]]:
        return jax.lax.cond(
            state.done,
            lambda: (params, state, state.value),
            lambda: (*self.take_step(loss, params, state), state.value),
        )

    def finish(self, loss: Loss, params: PyTree, state: DampedState) -> PyTree:
        return params

    def is_done(self, state: DampedState) -> Bool[Array, ""]:
        return state.done


class AbstractRolloutPhase(AbstractDampedPhase):
    """Damped steps towards the data, which the full rollout judges.

    The phase is done when the full rollout is good enough (`target`), when `patience`
    steps in a row gained less than a tenth, or when nothing lower is found.

    Attributes:
        window: samples between two restarts; an array, so that phases which differ
            in it alone share one compilation.
        target: root-mean-square residual of the full rollout at which the phase ends.
        damping: of the first step.
        patience: slow steps in a row after which it ends.
        converged: residual of the full rollout below which a fit that ended counts as
            converged, whatever ended it.
        steps: number of steps at most.
        linearisation: solver of the Jacobian and of the trial points. It may be
            cruder than that of the objective, which decides where the solution is.
    """

    window: eqx.AbstractVar[Int[Array, ""]]
    target: eqx.AbstractVar[Float[Array, ""]]
    damping: eqx.AbstractVar[Float[Array, ""]]
    patience: eqx.AbstractVar[Int[Array, ""]]
    converged: eqx.AbstractVar[Float[Array, ""]]
    steps: eqx.AbstractVar[int]
    linearisation: eqx.AbstractVar[FixedStep]

    @abc.abstractmethod
    def best_step(
        self, windows: Windows, theta: Float[Array, " parameter"], state: DampedState
    ) -> DampedStep:
        """The best of several steps from these parameters."""

    @property
    def num_steps(self) -> int:
        return self.steps

    @property
    def chunk_steps(self) -> int:
        return 1

    def init(self, loss: Loss, params: PyTree, value: Float[Array, ""]) -> DampedState:
        return DampedState.begin(self.damping, value)

    def take_step(
        self, problem: Any, params: PyTree, state: DampedState
    ) -> tuple[PyTree, DampedState]:
        theta, unravel = ravel_pytree(params)
        windows = Windows.of(problem, params, self.window, self.linearisation)
        step = self.best_step(windows, theta, state)
        # Windows flatter: the phase is judged by rollouts of the whole length.
        full, coloured = windows.full_error(step.theta)
        slow = jnp.where(step.left > SLOW, state.slow + 1, 0)
        state = DampedState(
            damping=step.damping,
            slow=slow,
            value=windows.count * full**2,
            promised=step.promised,
            coloured=coloured,
            exact=full < jnp.maximum(self.target, self.converged),
            done=(full < self.target) | (slow >= self.patience),
        )
        return unravel(step.theta), state

    def outcome(self, state: DampedState) -> Int[Array, ""]:
        spent = state.promised < NEGLIGIBLE
        noise = spent & ~state.coloured
        ended = jnp.where(spent, Outcome.MISFIT, Outcome.STALLED)
        return jnp.where(state.exact | noise, Outcome.CONVERGED, ended)


SLOW = 0.81
"""Share of the squares that a slow step leaves: a tenth less residual."""

NEGLIGIBLE = 1e-3
"""Share of the squares that a linear step promises to save, below which none counts."""
