"""`fit`: a recipe of phases applied to one model, or to many at once."""

import abc
import enum
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from pinav.dynamics import AbstractDynamics, with_dtype
from pinav.errors import FitError, InputError
from pinav.fitting.objectives import AbstractObjective, Observations, TrajectoryLoss
from pinav.fitting.phases import AbstractPhase
from pinav.trajectories import Trajectories

Recipe = Sequence[AbstractPhase]
Trainable = Callable[[Any], PyTree]


class FitOutcome(enum.IntEnum):
    """How a fit ended."""

    COMPLETED = 0
    DIVERGED = 1


class Fit(eqx.Module):
    """A fitted model.

    Attributes:
        model: the model with its trained leaves, in the precision of the fit.
        initial_model: the model before the first step.
        losses: loss before each step and after the last one.
        phases: name of each phase and the step at which it began.
        outcome: diverged when the final loss is not finite.
    """

    model: AbstractDynamics
    initial_model: AbstractDynamics
    losses: Float[np.ndarray, " step"]
    phases: tuple[tuple[str, int], ...] = eqx.field(static=True)
    outcome: FitOutcome = eqx.field(static=True)


class FitState(eqx.Module):
    """Everything that an interrupted fit needs to go on.

    Attributes:
        params: trained leaves of all members, stacked.
        minimiser: state of the phase in progress, stacked.
        losses: loss of each member before each step taken so far; NaN beyond.
        starts: number of steps taken before each phase that has begun; the last one
            is in progress, unless there is one more than phases: then all are done.
        taken: steps taken, over all phases.
    """

    params: PyTree
    minimiser: PyTree
    losses: Float[Array, "member step"]
    starts: tuple[int, ...] = eqx.field(static=True)
    taken: int = eqx.field(static=True)

    @property
    def phase(self) -> int:
        """Index of the phase in progress."""
        return len(self.starts) - 1


class FitProgress(eqx.Module):
    """What a progress bar shows after each chunk.

    Attributes:
        phase: name of the phase.
        done: steps done, over all phases.
        total: steps of the whole recipe.
        losses: loss of each member before each step of the chunk.
    """

    phase: str
    done: int
    total: int
    losses: Float[np.ndarray, "member step"]


class AbstractCheckpoint(abc.ABC):
    """Where a fit keeps its state, so that it can go on after an interruption."""

    @abc.abstractmethod
    def load(self, like: Callable[[int], FitState]) -> FitState | None:
        """The saved state, or None; `like(phase)` is a state of the same shape."""

    @abc.abstractmethod
    def save(self, state: FitState) -> None:
        """Keep `state` in place of the one saved before."""


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
    if throw and result.outcome is FitOutcome.DIVERGED:
        raise FitError(
            "the fit diverged: its loss is not finite; use a smaller learning rate, "
            "shorter trajectories, or throw=False to get what was computed"
        )
    return result


def fit_many(
    models: Sequence[AbstractDynamics],
    trajectories: Trajectories,
    recipe: Recipe,
    *,
    trainable: Trainable,
    objective: AbstractObjective | None = None,
    dtype: type = jnp.float32,
    checkpoint: AbstractCheckpoint | None = None,
    on_chunk: Callable[[FitProgress], None] | None = None,
) -> list[Fit]:
    """Fit several models that differ in their trained leaves, in one compiled call.

    Args:
        models: starts of the fit, such as one network per seed.
        trajectories: what is observed.
        recipe: phases, run one after the other.
        trainable: picks the leaves that train, such as
            `lambda m: (m.environment.network, m.drag.damping)`.
        objective: what is minimised; `TrajectoryLoss()` unless given.
        dtype: precision of the fit; the paper's is float32.
        checkpoint: where the state is kept after each chunk, and found again.
        on_chunk: called after each chunk of steps.

    Returns:
        One `Fit` per model; a diverged one says so in its `outcome`.

    Raises:
        InputError: nothing to train, an empty recipe, or trajectories that the
            objective cannot use.
    """
    objective = TrajectoryLoss() if objective is None else objective
    if not recipe or not models:
        raise InputError("fit: expected at least one model and one phase")
    objective.check(trajectories)
    models = [with_dtype(model, dtype) for model in models]
    # A float32 fit must not meet float64 defaults inside the minimisers.
    with jax.enable_x64(jnp.dtype(dtype) == jnp.float64):
        task = _FitTask.of(models, trajectories, recipe, trainable, objective, dtype)
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
    """The parts of a fit that do not change while it runs."""

    problem: Problem
    initial_params: PyTree
    recipe: tuple[AbstractPhase, ...]

    @classmethod
    def of(cls, models, trajectories, recipe, trainable, objective, dtype):
        parts = [split_trainable(m, trainable, dtype) for m in models]
        stacked = jax.tree.map(
            lambda *leaves: jnp.stack(leaves), *(p for p, _ in parts)
        )
        observations = Observations.of(trajectories, dtype)
        return cls(
            Problem(parts[0][1], observations, objective), stacked, tuple(recipe)
        )

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
        """State of the minimiser at the start of a phase; nothing after the last."""
        if phase == len(self.recipe):
            return ()
        return _begin_phase(self.problem, self.recipe[phase], params)

    def advance(self, state, checkpoint, on_chunk) -> FitState:
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
        )
        starts, taken = state.starts, state.taken + count
        if count == left or bool(done):
            params = _finish_phase(self.problem, phase, params, minimiser)
            starts = (*starts, taken)
            minimiser = self.begin(len(starts) - 1, params)
            if len(starts) > len(self.recipe):
                final = _member_losses(self.problem, params)
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
            outcome = FitOutcome.COMPLETED if finite else FitOutcome.DIVERGED
            return Fit(model, initial, losses[member], phases, outcome)

        return [one(member) for member in range(losses.shape[0])]


@eqx.filter_jit
def _begin_phase(problem: Problem, phase: AbstractPhase, params: PyTree) -> PyTree:
    return jax.vmap(lambda p: phase.init(problem, p))(params)


@eqx.filter_jit
def _finish_phase(problem: Problem, phase: AbstractPhase, params, minimiser):
    return jax.vmap(lambda p, s: phase.finish(problem, p, s))(params, minimiser)


@eqx.filter_jit
def _member_losses(problem: Problem, params: PyTree):
    return jax.vmap(problem)(params)


@eqx.filter_jit
def _run_chunk(problem, phase, params, minimiser, losses, position):
    """Take `count` steps from `offset`: traced numbers, so that one compile serves.

    Phases that differ in their arrays alone, such as the window of `GaussNewton`,
    share the compiled function too.
    """
    offset, count = position

    def body(index, carry):
        params, minimiser, losses = carry
        step = jax.vmap(lambda p, s: phase.step(problem, p, s))
        params, minimiser, values = step(params, minimiser)
        losses = losses.at[:, offset + index].set(values.astype(losses.dtype))
        return params, minimiser, losses

    carry = jax.lax.fori_loop(0, count, body, (params, minimiser, losses))
    return *carry, jnp.all(jax.vmap(phase.is_done)(carry[1]))


def split_trainable(model: Any, trainable: Trainable, dtype: type):
    """The model as (leaves that train, everything else), to be recombined.

    Args:
        model: the model.
        trainable: picks a subtree or a tuple of subtrees; their inexact arrays and
            Python floats train.
        dtype: floating-point type of the leaves that train.

    Raises:
        InputError: the selection holds no number that could train.
    """

    def as_array(leaf):
        return jnp.asarray(leaf, dtype) if _is_number(leaf) else leaf

    chosen = jax.tree.map(as_array, trainable(model))
    model = eqx.tree_at(trainable, model, chosen)
    spec = jax.tree.map(lambda _: False, model)
    spec = eqx.tree_at(trainable, spec, jax.tree.map(eqx.is_inexact_array, chosen))
    if not any(jax.tree.leaves(spec)):
        raise InputError(
            "fit trainable: the selection holds no floating-point array or number; "
            "pick leaves of the model, such as lambda m: m.environment"
        )
    return eqx.partition(model, spec)


def _is_number(leaf) -> bool:
    return isinstance(leaf, float) or eqx.is_inexact_array(leaf)
