"""`fit`: a recipe of phases applied to one model, or to many at once.

The members of a fit take their steps side by side or one after the other.
"""

from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int, PyTree, Shaped

from pinav.arguments import on_device
from pinav.dynamics import AbstractDynamics, with_dtype
from pinav.errors import FitError, InputError
from pinav.fitting.matching.phases import AbstractPhase
from pinav.fitting.matching.state import (
    AbstractCheckpoint,
    AbstractObjective,
    Fit,
    FitProgress,
    FitState,
    Observations,
    Trainable,
    TrajectoryLoss,
    split_trainable,
)
from pinav.fitting.outcome import Outcome
from pinav.trajectories import Trajectories


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


_compiled_for_each = eqx.filter_jit(_for_each)


def _loss(problem: Problem, params: PyTree) -> Float[Array, ""]:
    return problem(params)


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


Recipe = Sequence[AbstractPhase]


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
        trainable: picks the leaves that train, such as
            `lambda m: (m.environment.network, m.drag.damping)`.
        objective: what is minimised; `TrajectoryLoss()` unless given.
        dtype: precision of the fit; the paper's is float32.
        at_once: models that are computed side by side; fewer need less memory. Unless
            given, all of them, but on a CPU one after the other where the phase says so
            (`GaussNewton`): a fit that is done then costs nothing more.
        checkpoint: where the state is kept after each chunk, and found again.

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
    shared = isinstance(trajectories, Trajectories)
    several = [trajectories] if shared else list(trajectories)
    if not shared and len(several) != len(models):
        raise InputError(
            "fit_many trajectories: expected one, or one for each of the "
            f"{len(models)} models, got {len(several)}"
        )
    for own in several:
        objective.check(own)
    models = [with_dtype(model, dtype) for model in models]
    # A float32 fit must not meet float64 defaults inside the minimisers.
    with jax.enable_x64(jnp.dtype(dtype) == jnp.float64):
        observations = _stack([Observations.of(own, dtype) for own in several])
        # Arrays made with x64 on become what the precision of the fit makes of them.
        phases = jax.tree.map(
            lambda a: on_device(np.asarray(a)) if eqx.is_array(a) else a, list(recipe)
        )
        task = _FitTask.of(models, observations, phases, trainable, objective, at_once)
        start = task.state_before(0)
        state = checkpoint.load(task.state_before) if checkpoint else None
        state = start if state is None else state
        with ThreadPoolExecutor(1) as beside:
            # Steps leave a core idle, on which the phases to come can be compiled.
            compiled = beside.submit(task.compile_after, state.phase)
            while state.phase < len(recipe):
                state = task.advance(state, checkpoint, on_chunk)
            compiled.result()
        return task.results(start, state)


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
        stacked = jax.tree.map(_stack_leaves, *(p for p, _ in parts))
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
        values = self.for_each(_loss, params)
        return self.for_each(self.recipe[phase].init, params, values)

    def for_each(self, function: Callable[..., PyTree], *members: PyTree) -> PyTree:
        """A function of the problem and of each member's values, for all members."""
        return _compiled_for_each(function, self.problem, members, self.at_once)

    def compile_after(self, phase: int) -> None:
        """Compile the steps of all phases after this one, by taking none of them.

        It is called from another thread, to which the precision in force here is told:
        JAX keeps it for each thread.
        """
        compiled = {_program(one) for one in self.recipe[phase : phase + 1]}
        with jax.enable_x64(self.problem.observations.times.dtype == jnp.float64):
            for number in range(phase + 1, len(self.recipe)):
                if _program(self.recipe[number]) not in compiled:
                    compiled.add(_program(self.recipe[number]))
                    self.take_steps(self.state_before(number), 0)

    def take_steps(
        self, state: FitState, count: int
    ) -> tuple[PyTree, PyTree, Float[Array, "member step"], Bool[Array, ""]]:
        """As `run_chunk`, from a state in the middle of its phase."""
        phase = self.recipe[state.phase]
        alone = not phase.side_by_side and jax.default_backend() == "cpu"
        return run_chunk(
            self.problem,
            phase,
            state.params,
            state.minimiser,
            state.losses,
            jnp.asarray([state.taken, count]),
            1 if self.at_once is None and alone else self.at_once,
        )

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
        params, minimiser, losses, done = self.take_steps(state, count)
        starts, taken = state.starts, state.taken + count
        if count == left or bool(done):
            starts = (*starts, taken)
            outcomes = _outcomes(phase, minimiser)
            minimiser = self.begin(len(starts) - 1, params)
            if len(starts) > len(self.recipe):
                minimiser = outcomes.astype(minimiser.dtype)
                final = self.for_each(_loss, params)
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
                self.problem.model(
                    jax.tree.map(lambda a: on_device(np.asarray(a)[member]), params)
                )
                for params in (state.params, start.params)
            )
            finite = bool(np.isfinite(losses[member, -1]))
            judged = Outcome(int(state.minimiser[member]))
            outcome = judged if finite else Outcome.DIVERGED
            return Fit(model, initial, losses[member], phases, outcome)

        return [one(member) for member in range(losses.shape[0])]


def _program(phase: AbstractPhase) -> Hashable:
    """What phases that share a compiled program have in common."""
    leaves, structure = jax.tree.flatten(phase)
    return structure, tuple((jnp.shape(leaf), jnp.result_type(leaf)) for leaf in leaves)


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

    def pad(
        array: Shaped[Array, "trajectory time ..."],
    ) -> Shaped[np.ndarray, "trajectory longest ..."]:
        widths = [(0, 0), (0, longest - array.shape[1])] + [(0, 0)] * (array.ndim - 2)
        return np.pad(array, widths, "constant" if array.dtype == bool else "edge")

    padded = [jax.tree.map(pad, one) for one in several]
    return jax.tree.map(_stack_leaves, *padded)


def _stack_leaves(*leaves: ArrayLike) -> Array:
    """A leaf of all members, with an axis in front; numpy compiles nothing for it."""
    return on_device(np.stack(leaves))


@eqx.filter_jit
def _outcomes(phase: AbstractPhase, minimiser: PyTree) -> Int[Array, " member"]:
    return jax.vmap(phase.outcome)(minimiser)
