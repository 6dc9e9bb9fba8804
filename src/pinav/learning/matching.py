"""Trajectory matching: the paper's recipe or the default one, and its losses."""

import dataclasses
from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.dynamics import AbstractDynamics, FixedStep
from pinav.fitting import (
    AbstractCheckpoint,
    AbstractObjective,
    AbstractPhase,
    Fit,
    FitProgress,
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
from pinav.fitting.matching.state import Trainable
from pinav.forces import ZeroForce, as_learned_force
from pinav.learning.recipes import Curriculum, Paper
from pinav.trajectories import Trajectories


@dataclasses.dataclass(frozen=True)
class Matching:
    """Everything of `fit_in_turns` that a recipe's name decides.

    Attributes:
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
    recipe: Curriculum | Paper, data: Trajectories, model: AbstractDynamics
) -> Matching:
    """The paper's recipe as the paper has it, or the default one.

    The default begins with propagated defects where every state is observed, and turns
    to the curriculum of windows where these fail or some states are missing.
    """
    if isinstance(recipe, Paper):
        phases = paper_recipe(recipe.adam_steps, recipe.lbfgs_steps)
        return Matching((phases,), TrajectoryLoss(FixedStep()), jnp.float32)
    max_steps = recipe.max_steps
    substeps = substeps_for(data)
    recipes = (curriculum(data, max_steps=max_steps),)
    if is_complete(data):
        learned = as_learned_force(getattr(model, "environment", ZeroForce()))
        linear = learned is not None and learned.is_linear
        rates = None if linear else rates_to_match(model, data)
        if linear or rates is not None:
            steps = DEFECT_STEPS * max_steps
            root = prior_root(model, data) if linear else None
            first = defect_recipe(
                data, rates=rates, prior_root=root, substeps=substeps, max_steps=steps
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


@dataclasses.dataclass(frozen=True)
class Losses:
    """The loss curves of fits that share a recipe.

    Attributes:
        phases: name of each phase of the recipe, and the step at which it began.
    """

    values: Float[np.ndarray, "fit step"]
    phases: tuple[tuple[str, int], ...]
    outcomes: tuple[str, ...]

    @classmethod
    def of(cls, fits: Sequence[Fit]) -> "Losses":
        """Those of given fits."""
        return cls(
            np.stack([np.asarray(fit.losses) for fit in fits]),
            tuple((str(name), int(start)) for name, start in fits[0].phases),
            tuple(str(fit.outcome) for fit in fits),
        )
