"""Phases of a fit as values: each minimises a loss for a number of steps.

A phase works on one model. `fit` batches it over many and runs it in chunks.
"""

import abc
from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int, PyTree

from pinav.arguments import check_positive
from pinav.fitting.outcome import Outcome

Loss = Callable[[PyTree], Float[Array, ""]]
"""Loss of the parameters; a `Problem` is one, and tells a phase more if it asks."""


class AbstractPhase(eqx.Module):
    """An iterative minimiser written as a start and steps.

    Attributes:
        chunk_steps: steps between two checkpoints: about a second of work.
        side_by_side: whether a CPU is quicker with many fits side by side than one by
            one. Many small steps are; large ones are not, and a fit that is done then
            costs as much as one that is not.
    """

    chunk_steps: ClassVar[int]
    side_by_side: ClassVar[bool]

    @property
    @abc.abstractmethod
    def num_steps(self) -> int:
        """Number of steps at most."""

    @property
    @abc.abstractmethod
    def name(self) -> str:
        """What progress bars and reports call the phase."""

    @abc.abstractmethod
    def init(self, loss: Loss, params: PyTree, value: Float[Array, ""]) -> PyTree:
        """State of the minimiser before its first step; `value` is the loss there."""

    @abc.abstractmethod
    def step(
        self, loss: Loss, params: PyTree, state: PyTree
    ) -> tuple[PyTree, PyTree, Float[Array, ""]]:
        """Next parameters, next state, and the loss at the *given* parameters."""

    @abc.abstractmethod
    def is_done(self, state: PyTree) -> Bool[Array, ""]:
        """Whether further steps are pointless; a done phase no longer moves."""

    @abc.abstractmethod
    def outcome(self, state: PyTree) -> Int[Array, ""]:
        """The `Outcome` of a phase that ended in this state."""


class AbstractGradientPhase(AbstractPhase):
    """Many small steps along gradients, all of which are taken."""

    side_by_side: ClassVar[bool] = True
    steps: eqx.AbstractVar[int]

    @property
    def num_steps(self) -> int:
        return self.steps

    def is_done(self, state: PyTree) -> Bool[Array, ""]:
        return jnp.zeros((), bool)

    def outcome(self, state: PyTree) -> Int[Array, ""]:
        return jnp.asarray(Outcome.COMPLETED)


class Adam(AbstractGradientPhase):
    """Adam at a constant learning rate.

    Raises:
        InputError: `learning_rate` or `steps` is not positive.

    References:
        Kingma and Ba, ICLR 2015; PI-NAV paper, Table 1.
    """

    learning_rate: float = eqx.field(static=True)
    steps: int = eqx.field(static=True)
    chunk_steps: ClassVar[int] = 250

    def __check_init__(self) -> None:
        check_positive(self, "learning_rate", "steps")

    @property
    def name(self) -> str:
        return "Adam"

    def init(self, loss: Loss, params: PyTree, value: Float[Array, ""]) -> PyTree:
        return optax.adam(self.learning_rate).init(params)

    def step(
        self, loss: Loss, params: PyTree, state: PyTree
    ) -> tuple[PyTree, PyTree, Float[Array, ""]]:
        value, gradient = jax.value_and_grad(loss)(params)
        with jax.numpy_dtype_promotion("standard"):  # optax: float32 ** integer
            updates, state = optax.adam(self.learning_rate).update(gradient, state)
        return eqx.apply_updates(params, updates), state, value


class LBFGS(AbstractGradientPhase):
    """Limited-memory BFGS with a weak Wolfe line search by bisection.

    The line search is ours because it must evaluate the loss at one place in the
    program: optax's zoom search does so at five, and each would be compiled.

    Attributes:
        memory: number of past steps that shape the curvature.
        max_evaluations: loss gradients per step at most.

    Raises:
        InputError: `steps`, `memory` or `max_evaluations` is not positive.

    References:
        Liu and Nocedal, Math. Program. 45, 1989; line search: Lewis and Overton,
        Math. Program. 141, 2013; PI-NAV paper, Table 1.
    """

    steps: int = eqx.field(static=True)
    memory: int = eqx.field(static=True, default=10)
    max_evaluations: int = eqx.field(static=True, default=20)
    chunk_steps: ClassVar[int] = 25

    def __check_init__(self) -> None:
        check_positive(self, "steps", "memory", "max_evaluations")

    @property
    def name(self) -> str:
        return "L-BFGS"

    def init(self, loss: Loss, params: PyTree, value: Float[Array, ""]) -> PyTree:
        gradient = jax.grad(loss)(params)
        return optax.scale_by_lbfgs(self.memory).init(params), value, gradient

    def step(
        self, loss: Loss, params: PyTree, state: PyTree
    ) -> tuple[PyTree, PyTree, Float[Array, ""]]:
        curvature, value, gradient = state
        with jax.numpy_dtype_promotion("standard"):  # optax mixes integers in
            ascent, curvature = optax.scale_by_lbfgs(self.memory).update(
                gradient, curvature, params
            )
        direction = jax.tree.map(jnp.negative, ascent)
        step = _weak_wolfe_search(
            jax.value_and_grad(loss),
            (params, value, gradient),
            direction,
            self.max_evaluations,
        )
        params, next_value, next_gradient = step
        return params, (curvature, next_value, next_gradient), value


_Candidate = tuple[PyTree, Float[Array, ""], PyTree]
"""A point, the loss there and its gradient."""

_Search = tuple[
    Float[Array, ""],
    Float[Array, ""],
    Float[Array, ""],
    _Candidate,
    Int[Array, ""],
    Bool[Array, ""],
]
"""Steps too short and too long, the next step, the best point, evaluations, the end."""


def _weak_wolfe_search(
    value_and_grad: Callable[[PyTree], tuple[Float[Array, ""], PyTree]],
    start: _Candidate,
    direction: PyTree,
    max_evaluations: int,
) -> _Candidate:
    """Point along `direction` with enough decrease and a flatter slope.

    Bisects between a step too long (no decrease: Armijo, 1e-4) and one too short
    (still as steep: curvature, 0.9), doubling while no step was too long. Returns
    (point, value, gradient); the start itself where nothing lower was found.
    """
    params, value, gradient = start
    slope = jnp.asarray(optax.tree.vdot(gradient, direction))

    def unfinished(state: _Search) -> Bool[Array, ""]:
        _, _, _, _, evaluations, done = state
        return ~done & (evaluations < max_evaluations)

    def evaluate(state: _Search) -> _Search:
        low, high, length, best, evaluations, _ = state
        point = optax.tree.add_scale(params, length, direction)
        point_value, point_gradient = value_and_grad(point)
        # Sufficient decrease and curvature, with the usual constants 1e-4 and 0.9.
        enough = point_value <= value + 1e-4 * length * slope
        flat = jnp.asarray(optax.tree.vdot(point_gradient, direction)) >= 0.9 * slope
        candidate = (point, point_value, point_gradient)
        is_better = enough & (point_value <= best[1])
        best = jax.tree.map(lambda a, b: jnp.where(is_better, a, b), candidate, best)
        low, high = jnp.where(enough, length, low), jnp.where(enough, high, length)
        # Doubled until it is too long, then bisected between both conditions.
        length = jnp.where(jnp.isinf(high), 2.0 * low, 0.5 * (low + high))
        return low, high, length, best, evaluations + 1, enough & flat

    zero, one = jnp.zeros_like(value), jnp.ones_like(value)
    state = (zero, one * jnp.inf, one, start, jnp.asarray(0), jnp.zeros((), bool))
    return jax.lax.while_loop(unfinished, evaluate, state)[3]
