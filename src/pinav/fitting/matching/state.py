"""The result, state and objective of a fit by matching, and what it trains."""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree

from pinav.arguments import on_device
from pinav.dynamics import AbstractDynamics, AbstractSolver, FixedStep
from pinav.errors import InputError
from pinav.fitting.outcome import Outcome
from pinav.trajectories import Trajectories


class Fit(eqx.Module):
    """A fitted model.

    Attributes:
        model: the model with its trained leaves, in the precision of the fit.
        losses: loss before each step and after the last one.
        phases: name of each phase and the step at which it began.
    """

    model: AbstractDynamics
    initial_model: AbstractDynamics
    losses: Float[np.ndarray, " step"]
    phases: tuple[tuple[str, int], ...] = eqx.field(static=True)
    outcome: Outcome = eqx.field(static=True)


class FitState(eqx.Module):
    """Everything that an interrupted fit needs to go on.

    Attributes:
        params: trained leaves of all members, stacked.
        minimiser: state of the phase in progress, stacked; outcomes after the last.
        losses: loss of each member before each step taken so far; NaN beyond.
        starts: number of steps taken before each phase that has begun; the last one
            is in progress, unless there is one more than phases: then all are done.
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
        done: steps done, over all phases.
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


Trainable = Callable[[Any], PyTree]
"""Picks a subtree of a model, or a tuple of subtrees."""


def split_trainable(
    model: Any, trainable: Trainable, dtype: type
) -> tuple[PyTree, PyTree]:
    """The model as (leaves that train, everything else), to be recombined.

    Args:
        trainable: picks a subtree or a tuple of subtrees; their inexact arrays and
            Python floats train.

    Raises:
        InputError: the selection holds no number that could train.
    """

    def as_array(leaf: Any) -> Any:
        is_number = isinstance(leaf, float) or eqx.is_inexact_array(leaf)
        return jnp.asarray(leaf, dtype) if is_number else leaf

    def subtrees(model: Any) -> list[PyTree]:
        # nested tuples in one list, as `eqx.tree_at` needs them
        return jax.tree.leaves(
            trainable(model), is_leaf=lambda part: not isinstance(part, tuple | list)
        )

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


class Observations(eqx.Module):
    """Trajectories on the device, in the precision of the fit.

    Attributes:
        times: sample times [T]; padding repeats the last one.
        states: observed states; what was not observed is zero.
        observed: which entries of `states` are observations.
    """

    times: Float[Array, "trajectory time"]
    states: Float[Array, "trajectory time state"]
    observed: Bool[Array, "trajectory time state"]

    @classmethod
    def of(cls, trajectories: Trajectories, dtype: type) -> "Observations":
        """Observations of `trajectories` in the floating-point type `dtype`."""
        return cls(
            jnp.asarray(trajectories.times, dtype),
            jnp.asarray(trajectories.states, dtype),
            on_device(trajectories.observed),
        )


class AbstractObjective(eqx.Module):
    """A number that says how badly a model explains observations."""

    @abc.abstractmethod
    def __call__(
        self, model: AbstractDynamics, observations: Observations
    ) -> Float[Array, ""]:
        """Loss of `model`; smaller is better, not finite means diverged."""

    @abc.abstractmethod
    def check(self, trajectories: Trajectories) -> None:
        """Raise `InputError` where these trajectories cannot be used."""


class TrajectoryLoss(AbstractObjective):
    r"""Sum of squares $\sum_k |\hat u(t_k) - u(t_k)|^2$ over one rollout each.

    Every trajectory is rolled out from its first observed state; entries that were
    not observed do not count.

    Attributes:
        solver: how the rollout is integrated and its gradient taken.

    Raises:
        InputError: the first sample of a trajectory is not fully observed.

    References:
        PI-NAV paper, eq. (3).
    """

    solver: AbstractSolver = FixedStep()

    def __call__(
        self, model: AbstractDynamics, observations: Observations
    ) -> Float[Array, ""]:
        def residuals(
            times: Float[Array, " time"],
            states: Float[Array, "time state"],
            observed: Bool[Array, "time state"],
        ) -> Float[Array, "time state"]:
            ys, _ = self.solver.solve(model, states[0], times)
            return jnp.where(observed, ys - states, 0.0)

        per_trajectory = jax.vmap(residuals)(
            observations.times, observations.states, observations.observed
        )
        return jnp.sum(per_trajectory**2)

    def check(self, trajectories: Trajectories) -> None:
        for index, first in enumerate(trajectories.observed[:, 0]):
            if not first.all():
                raise InputError(
                    f"trajectory {index}: its first sample must be fully observed, "
                    "because the rollout starts there; drop the samples before it, or "
                    "choose the recipe bayes"
                )
