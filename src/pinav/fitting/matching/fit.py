"""`fit`: a recipe of phases applied to one model, or to many at once."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree, Shaped

from pinav.dynamics import AbstractDynamics, with_dtype
from pinav.errors import FitError, InputError
from pinav.fitting.matching.objectives import (
    AbstractObjective,
    Observations,
    TrajectoryLoss,
)
from pinav.fitting.matching.phases import AbstractPhase
from pinav.fitting.matching.state import (
    AbstractCheckpoint,
    Fit,
    FitProgress,
    FitState,
)
from pinav.fitting.outcome import Outcome
from pinav.trajectories import Trajectories

Recipe = Sequence[AbstractPhase]
Trainable = Callable[[Any], PyTree]


def fit(
    model: AbstractDynamics,
    trajectories: Trajectories,
    recipe: Recipe,
    *,
    trainable: Trainable,
    objective: AbstractObjective | None = None,
    dtype: type = jnp.float32,
    checkpoint: AbstractCheckpoint | None = None,
    on_chunk: Callable[[FitProgress], None] | None = None,
    throw: bool = True,
) -> Fit:
    """Fit one model: see `fit_many`.

    Raises:
        FitError: the fit diverged and `throw` is true.
    """
    (result,) = fit_many(
        [model],
        trajectories,
        recipe,
        trainable=trainable,
        objective=objective,
        dtype=dtype,
        checkpoint=checkpoint,
        on_chunk=on_chunk,
    )
    if throw and result.outcome is Outcome.DIVERGED:
        raise FitError(
            "the fit diverged: its loss is not finite; use a smaller learning rate, "
            "shorter trajectories, or throw=False to get what was computed"
        )
    return result


def fit_many(
    models: Sequence[AbstractDynamics],
    trajectories: Trajectories | Sequence[Trajectories],
    recipe: Recipe,
    *,
    trainable: Trainable,
    objective: AbstractObjective | None = None,
    dtype: type = jnp.float32,
    at_once: int | None = None,
    checkpoint: AbstractCheckpoint | None = None,
    on_chunk: Callable[[FitProgress], None] | None = None,
) -> list[Fit]:
    """Fit several models that differ in their trained leaves, in one compiled call.

    Args:
        models: starts of the fit, such as one network per seed.
        trajectories: what is observed; one for each model, such as draws of the noise
            or resamples (`pinav.trajectories.bootstrap`), or one that all share.
        recipe: phases, run one after the other.
        trainable: picks the leaves that train, such as
            `lambda m: (m.environment.network, m.drag.damping)`.
        objective: what is minimised; `TrajectoryLoss()` unless given.
        dtype: precision of the fit; the paper's is float32.
        at_once: models that are computed side by side; fewer need less memory. Unless
            given, all of them, but on a CPU one after the other where the phase says so
            (`GaussNewton`): a fit that is done then costs nothing more.
        checkpoint: where the state is kept after each chunk, and found again.
        on_chunk: called after each chunk of steps.

    Returns:
        One `Fit` per model; a diverged one says so in its `outcome`.

    Raises:
        InputError: nothing to train, an empty recipe, or trajectories that the
            objective cannot use or of which there are not as many as models.
    """
    objective = TrajectoryLoss() if objective is None else objective
    if not recipe or not models:
        raise InputError("fit: expected at least one model and one phase")
    if at_once is not None and at_once < 1:
        raise InputError(f"fit_many at_once: expected 1 or more, got {at_once}")
    several = _one_each(trajectories, len(models))
    for own in several:
        objective.check(own)
    models = [with_dtype(model, dtype) for model in models]
    # A float32 fit must not meet float64 defaults inside the minimisers.
    with jax.enable_x64(jnp.dtype(dtype) == jnp.float64):
        observations = _stack([Observations.of(own, dtype) for own in several])
        phases = [_in_mode(phase) for phase in recipe]
        task = _FitTask.of(models, observations, phases, trainable, objective, at_once)
        start = task.state_before(0)
        state = checkpoint.load(task.state_before) if checkpoint else None
        state = start if state is None else state
        while state.phase < len(recipe):
            state = task.advance(state, checkpoint, on_chunk)
        return task.results(start, state)


class Problem(eqx.Module):
    """What is minimised, as a function of the parameters alone.

    Attributes:
        static: the model without the leaves that train.
        observations: what the model is to explain.
        objective: how badly it does.
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


class _FitTask(eqx.Module):
    """The parts of a fit that do not change while it runs.

    The problem's observations have an axis in front: one entry that all members share,
    or one for each.
    """

    problem: Problem
    initial_params: PyTree
    recipe: tuple[AbstractPhase, ...]
    at_once: int | None = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        models: Sequence[AbstractDynamics],
        observations: Observations,
        recipe: Recipe,
        trainable: Trainable,
        objective: AbstractObjective,
        at_once: int | None,
    ) -> "_FitTask":
        dtype = observations.times.dtype.type
        parts = [split_trainable(m, trainable, dtype) for m in models]
        stacked = jax.tree.map(
            lambda *leaves: jnp.stack(leaves), *(p for p, _ in parts)
        )
        problem = Problem(parts[0][1], observations, objective)
        return cls(problem, stacked, tuple(recipe), at_once)

    @property
    def total_steps(self) -> int:
        return sum(phase.num_steps for phase in self.recipe)

    def state_before(self, phase: int) -> FitState:
        """A state in a phase, of the right shapes, with the initial parameters."""
        params = self.initial_params
        members = jax.tree.leaves(params)[0].shape[0]
        losses = jnp.full((members, self.total_steps + 1), jnp.nan)
        minimiser = self.begin(phase, params)
        return FitState(params, minimiser, losses, (0,) * (phase + 1), 0)

    def begin(self, phase: int, params: PyTree) -> PyTree:
        """State of the minimiser at the start of a phase; outcomes after the last."""
        if phase == len(self.recipe):
            return jnp.zeros(jax.tree.leaves(params)[0].shape[0], int)
        values = _member_losses(self.problem, params, self.at_once)
        members = (params, values)
        return _begin_phase(self.problem, self.recipe[phase], members, self.at_once)

    def abreast(self, phase: AbstractPhase) -> int | None:
        """How many members take a step side by side; None for all of them."""
        alone = not phase.side_by_side and jax.default_backend() == "cpu"
        return 1 if self.at_once is None and alone else self.at_once

    def advance(
        self,
        state: FitState,
        checkpoint: AbstractCheckpoint | None,
        on_chunk: Callable[[FitProgress], None] | None,
    ) -> FitState:
        """Run one chunk, and begin the next phase where this one is done."""
        phase = self.recipe[state.phase]
        left = phase.num_steps - (state.taken - state.starts[-1])
        count = min(phase.chunk_steps, left)
        params, minimiser, losses, done = _run_chunk(
            self.problem,
            phase,
            state.params,
            state.minimiser,
            state.losses,
            jnp.asarray([state.taken, count]),
            self.abreast(phase),
        )
        starts, taken = state.starts, state.taken + count
        if count == left or bool(done):
            params = _finish_phase(self.problem, phase, params, minimiser, self.at_once)
            starts = (*starts, taken)
            outcomes = jax.vmap(phase.outcome)(minimiser)
            minimiser = self.begin(len(starts) - 1, params)
            if len(starts) > len(self.recipe):
                minimiser = outcomes.astype(minimiser.dtype)
                final = _member_losses(self.problem, params, self.at_once)
                losses = losses.at[:, taken].set(final.astype(losses.dtype))
        chunk = np.asarray(losses)[:, state.taken : taken]
        state = FitState(params, minimiser, losses, starts, taken)
        if checkpoint:
            checkpoint.save(state)
        if on_chunk:
            on_chunk(FitProgress(phase.name, taken, self.total_steps, chunk))
        return state

    def results(self, start: FitState, state: FitState) -> list[Fit]:
        losses = np.asarray(state.losses)[:, : state.taken + 1]
        names = [phase.name for phase in self.recipe]
        phases = tuple(zip(names, state.starts[:-1], strict=True))

        def one(member: int) -> Fit:
            model, initial = (
                self.problem.model(jax.tree.map(lambda a: a[member], params))
                for params in (state.params, start.params)
            )
            finite = bool(np.isfinite(losses[member, -1]))
            judged = Outcome(int(state.minimiser[member]))
            outcome = judged if finite else Outcome.DIVERGED
            return Fit(model, initial, losses[member], phases, outcome)

        return [one(member) for member in range(losses.shape[0])]


def _in_mode(tree: PyTree) -> PyTree:
    """Arrays made with x64 on, as the mode in force would have made them."""
    return jax.tree.map(
        lambda leaf: jnp.asarray(np.asarray(leaf)) if eqx.is_array(leaf) else leaf, tree
    )


def _one_each(
    trajectories: Trajectories | Sequence[Trajectories], count: int
) -> list[Trajectories]:
    if isinstance(trajectories, Trajectories):
        return [trajectories]
    if len(trajectories) != count:
        raise InputError(
            f"fit_many trajectories: expected one, or one for each of the {count} "
            f"models, got {len(trajectories)}"
        )
    return list(trajectories)


def _stack(several: list[Observations]) -> Observations:
    """Observations with an axis in front, padded to one shape; padding is unobserved.

    Raises:
        InputError: numbers of trajectories or of channels differ.
    """
    kinds = {(one.states.shape[0], one.states.shape[2]) for one in several}
    if len(kinds) > 1:
        raise InputError(
            "fit_many trajectories: expected as many trajectories and channels for "
            "each model"
        )
    longest = max(one.times.shape[1] for one in several)

    def pad(array: Shaped[Array, "trajectory time ..."]) -> Shaped[Array, "..."]:
        widths = [(0, 0), (0, longest - array.shape[1])] + [(0, 0)] * (array.ndim - 2)
        return jnp.pad(array, widths, "constant" if array.dtype == bool else "edge")

    padded = [jax.tree.map(pad, one) for one in several]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *padded)


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
def _begin_phase(
    problem: Problem,
    phase: AbstractPhase,
    members: tuple[PyTree, ...],
    at_once: int | None,
) -> PyTree:
    return _for_each(phase.init, problem, members, at_once)


@eqx.filter_jit
def _finish_phase(
    problem: Problem,
    phase: AbstractPhase,
    params: PyTree,
    minimiser: PyTree,
    at_once: int | None,
) -> PyTree:
    return _for_each(phase.finish, problem, (params, minimiser), at_once)


@eqx.filter_jit
def _member_losses(
    problem: Problem, params: PyTree, at_once: int | None
) -> Float[Array, " member"]:
    return _for_each(lambda p, own: p(own), problem, (params,), at_once)


@eqx.filter_jit
def _run_chunk(
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


def split_trainable(
    model: Any, trainable: Trainable, dtype: type
) -> tuple[PyTree, PyTree]:
    """The model as (leaves that train, everything else), to be recombined.

    Args:
        model: the model.
        trainable: picks a subtree or a tuple of subtrees; their inexact arrays and
            Python floats train.
        dtype: floating-point type of the leaves that train.

    Raises:
        InputError: the selection holds no number that could train.
    """

    def as_array(leaf: Any) -> Any:
        return jnp.asarray(leaf, dtype) if _is_number(leaf) else leaf

    def subtrees(model: Any) -> list[PyTree]:
        return _without_nesting(trainable(model))

    chosen = jax.tree.map(as_array, subtrees(model))
    model = eqx.tree_at(subtrees, model, chosen)
    spec = jax.tree.map(lambda _: False, model)
    spec = eqx.tree_at(subtrees, spec, jax.tree.map(eqx.is_inexact_array, chosen))
    if not any(jax.tree.leaves(spec)):
        raise InputError(
            "fit trainable: the selection holds no floating-point array or number; "
            "pick leaves of the model, such as lambda m: m.environment"
        )
    return eqx.partition(model, spec)


def _without_nesting(selection: PyTree) -> list[PyTree]:
    """Subtrees of nested tuples in one list, as `eqx.tree_at` needs them."""
    return jax.tree.leaves(selection, is_leaf=lambda s: not isinstance(s, tuple | list))


def _is_number(leaf: Any) -> bool:
    return isinstance(leaf, float) or eqx.is_inexact_array(leaf)
