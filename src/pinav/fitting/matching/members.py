"""Steps of a phase for all members of a fit, side by side or one after the other."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree

from pinav.fitting.matching.phases import AbstractPhase
from pinav.fitting.matching.state import AbstractObjective, Observations


class Problem(eqx.Module):
    """What is minimised, as a function of the parameters alone.

    Attributes:
        static: the model without the leaves that train.
    """

    static: PyTree
    observations: Observations
    objective: AbstractObjective

    def model(self, params: PyTree) -> Any:
        """The model with these parameters."""
        return eqx.combine(params, self.static)

    def __call__(self, params: PyTree) -> Float[Array, ""]:
        """Loss of these parameters."""
        return self.objective(self.model(params), self.observations)


def _for_each(
    function: Callable[..., PyTree],
    problem: Problem,
    members: tuple[PyTree, ...],
    at_once: int | None,
) -> PyTree:
    """`function(problem, *member)` for all members, `at_once` of them side by side."""
    count = jax.tree.leaves(members)[0].shape[0]
    observations = problem.observations
    shared = observations.times.shape[0] == 1

    def one(own: Observations, *member: PyTree) -> PyTree:
        return function(eqx.tree_at(lambda p: p.observations, problem, own), *member)

    if shared:
        observations = jax.tree.map(lambda leaf: leaf[0], observations)
    if at_once is None or at_once >= count:
        axes = (None if shared else 0, *(0 for _ in members))
        return jax.vmap(one, axes)(observations, *members)
    # In a batch of one, both branches of a condition would still be computed.
    size = None if at_once == 1 else at_once
    if shared:
        return jax.lax.map(lambda m: one(observations, *m), members, batch_size=size)
    return jax.lax.map(lambda m: one(*m), (observations, *members), batch_size=size)


@eqx.filter_jit
def begin_phase(
    problem: Problem,
    phase: AbstractPhase,
    members: tuple[PyTree, ...],
    at_once: int | None,
) -> PyTree:
    """States of the minimiser at the start of a phase.

    Args:
        members: parameters and losses of each.
        at_once: members that are computed side by side; None for all of them.
    """
    return _for_each(phase.init, problem, members, at_once)


@eqx.filter_jit
def finish_phase(
    problem: Problem,
    phase: AbstractPhase,
    params: PyTree,
    minimiser: PyTree,
    at_once: int | None,
) -> PyTree:
    """Parameters of all members at the end of a phase; arguments as `begin_phase`."""
    return _for_each(phase.finish, problem, (params, minimiser), at_once)


@eqx.filter_jit
def member_losses(
    problem: Problem, params: PyTree, at_once: int | None
) -> Float[Array, " member"]:
    """Loss of each member."""
    return _for_each(lambda p, own: p(own), problem, (params,), at_once)


@eqx.filter_jit
def run_chunk(
    problem: Problem,
    phase: AbstractPhase,
    params: PyTree,
    minimiser: PyTree,
    losses: Float[Array, "member step"],
    position: Int[Array, "2"],
    at_once: int | None = None,
) -> tuple[PyTree, PyTree, Float[Array, "member step"], Bool[Array, ""]]:
    """Take `count` steps from `offset`: traced numbers, so that one compile serves.

    Phases that differ in their arrays alone, such as the window of `GaussNewton`,
    share the compiled function too.

    Args:
        position: `offset` and `count`.

    Returns:
        The three of them after the chunk, and whether all members are done.
    """
    offset, count = position

    def body(
        index: Int[Array, ""], carry: tuple[PyTree, PyTree, Float[Array, "member step"]]
    ) -> tuple[PyTree, PyTree, Float[Array, "member step"]]:
        params, minimiser, losses = carry
        params, minimiser, values = _for_each(
            phase.step, problem, (params, minimiser), at_once
        )
        losses = losses.at[:, offset + index].set(values.astype(losses.dtype))
        return params, minimiser, losses

    carry = jax.lax.fori_loop(0, count, body, (params, minimiser, losses))
    return *carry, jnp.all(jax.vmap(phase.is_done)(carry[1]))
