"""What a fit leaves behind: its result, its state while it runs, and its progress."""

import abc
from collections.abc import Callable

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, PyTree

from pinav.dynamics import AbstractDynamics
from pinav.fitting.outcome import Outcome


class Fit(eqx.Module):
    """A fitted model.

    Attributes:
        model: the model with its trained leaves, in the precision of the fit.
        initial_model: the model before the first step.
        losses: loss before each step and after the last one.
        phases: name of each phase and the step at which it began.
        outcome: how the last phase ended.
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
