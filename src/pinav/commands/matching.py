"""Trajectory matching by the name of its recipe, and its losses on disk."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.dynamics import AbstractDynamics, FixedStep
from pinav.errors import InputError
from pinav.fitting import (
    AbstractObjective,
    AbstractPhase,
    Fit,
    TrajectoryLoss,
    curriculum,
    defect_recipe,
    fit_in_turns,
    fit_with_finer_steps,
    is_complete,
    paper_recipe,
    prior_root,
    rates_to_match,
    substeps_for,
)
from pinav.fitting.matching.state import AbstractCheckpoint, FitProgress
from pinav.fitting.matching.trainable import Trainable
from pinav.forces import ZeroForce, as_learned_force
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories


@runtime_checkable
class MatchingSettings(Protocol):
    """The settings of every command that matches trajectories."""

    @property
    def recipe(self) -> str:
        """Name of the recipe."""
        ...

    @property
    def max_steps(self) -> int:
        """Steps of each phase of the curriculum at most."""
        ...

    @property
    def adam_steps(self) -> int:
        """Steps of Adam in the paper's recipe."""
        ...

    @property
    def lbfgs_steps(self) -> int:
        """Steps of L-BFGS in the paper's recipe."""
        ...


@dataclasses.dataclass(frozen=True)
class CurriculumSettings:
    """Settings of the default recipe, or of the paper's where that is named.

    Attributes:
        recipe: `curriculum` or `paper`.
        max_steps: steps of each phase of the curriculum at most.
        adam_steps: of the paper's recipe.
        lbfgs_steps: of the paper's recipe.
    """

    recipe: str = "curriculum"
    max_steps: int = 20
    adam_steps: int = 7500
    lbfgs_steps: int = 500


@dataclasses.dataclass(frozen=True)
class Matching:
    """Everything of `fit_in_turns` that a recipe's name decides.

    Attributes:
        recipes: the phases of each attempt.
        objective: what they minimise.
        dtype: floating-point type of the fit.
        finer: the objective by finer steps, which a fit must follow, too; None where
            its own steps are part of the recipe.
    """

    recipes: tuple[tuple[AbstractPhase, ...], ...]
    objective: AbstractObjective
    dtype: type
    finer: AbstractObjective | None = None

    @property
    def precision(self) -> str:
        """Name of the floating-point type, for files."""
        return jnp.dtype(self.dtype).name

    def fit(
        self,
        models: Sequence[AbstractDynamics],
        data: Trajectories,
        *,
        trainable: Trainable,
        checkpoint: AbstractCheckpoint | None = None,
        on_chunk: Callable[[FitProgress], None] | None = None,
    ) -> list[Fit]:
        """Fit several models; see `fit_in_turns` and `fit_with_finer_steps`."""
        fits = fit_in_turns(
            models,
            data,
            self.recipes,
            trainable=trainable,
            objective=self.objective,
            dtype=self.dtype,
            checkpoint=checkpoint,
            on_chunk=on_chunk,
        )
        if self.finer is None:
            return fits
        return fit_with_finer_steps(
            fits,
            data,
            self.recipes[0][-1:],
            trainable=trainable,
            objective=self.finer,
            dtype=self.dtype,
            on_chunk=on_chunk,
        )


def matching(
    settings: MatchingSettings, data: Trajectories, model: AbstractDynamics
) -> Matching:
    """The paper's recipe as the paper has it, or the default one.

    The default begins with propagated defects where every state is observed, and turns
    to the curriculum of windows where these fail or some states are missing.

    Args:
        settings: name and steps of the recipe.
        data: the trajectories.
        model: one of those to be fitted, untrained.
    """
    if settings.recipe == "paper":
        recipe = paper_recipe(settings.adam_steps, settings.lbfgs_steps)
        return Matching((recipe,), TrajectoryLoss(FixedStep()), jnp.float32)
    substeps = substeps_for(data)
    recipes = (curriculum(data, max_steps=settings.max_steps),)
    if is_complete(data):
        linear = _is_linear(model)
        rates = None if linear else rates_to_match(model, data)
        if linear or rates is not None:
            steps = DEFECT_STEPS * settings.max_steps
            root = prior_root(model, data) if linear else None
            first = defect_recipe(
                data,
                rates=rates,
                prior_root=root,
                substeps=substeps,
                max_steps=steps,
            )
            recipes = (first, *recipes) if linear else (first, first, *recipes)
    coarse, fine = (
        TrajectoryLoss(FixedStep(substeps=steps * substeps)) for steps in (2, FINER)
    )
    return Matching(recipes, coarse, jnp.float64, fine)


FINER = 8
"""Steps that confirm a fit, for each of those that its linearisation takes."""


DEFECT_STEPS = 2
"""Steps of propagated defects for each of a window."""


def _is_linear(model: AbstractDynamics) -> bool:
    environment = getattr(model, "environment", ZeroForce())
    learned = as_learned_force(environment)
    return learned is not None and learned.is_linear


def check_starts(data: Trajectories) -> None:
    """Require a first sample from which a rollout can start.

    Raises:
        InputError: a trajectory has none.
    """
    for index, first in enumerate(data.observed[:, 0]):
        if not first.all():
            raise InputError(
                f"trajectory {index}: its first sample must be fully observed, because "
                "the rollout starts there; drop the samples before it, or choose "
                "--recipe bayes"
            )


@dataclasses.dataclass(frozen=True)
class Losses:
    """The loss curves of fits that share a recipe.

    Attributes:
        values: losses of each fit by step.
        phases: name of each phase of the recipe, and the step at which it began.
        outcomes: the word for how each fit ended.
    """

    values: Float[np.ndarray, "fit step"]
    phases: list[tuple[str, int]]
    outcomes: list[str]


def write_losses(name: str, fits: Sequence[Fit], folder: RunFolder) -> None:
    """Write the loss curves of fits that share a recipe to `losses-NAME.npz`."""
    folder.write_arrays(
        f"losses-{name}.npz",
        {
            "losses": np.stack([fit.losses for fit in fits]),
            "phase_starts": np.array([start for _, start in fits[0].phases]),
            "phase_names": np.array([phase for phase, _ in fits[0].phases]),
            "outcomes": np.array([str(fit.outcome) for fit in fits]),
        },
    )


def read_losses(name: str, folder: RunFolder) -> Losses:
    """Read what `write_losses` wrote."""
    stored = folder.read_arrays(f"losses-{name}.npz")
    names, starts = stored["phase_names"], stored["phase_starts"]
    phases = [(str(n), int(start)) for n, start in zip(names, starts, strict=True)]
    return Losses(stored["losses"], phases, [str(word) for word in stored["outcomes"]])
