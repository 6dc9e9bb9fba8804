"""Trajectory matching, by the name of its recipe."""

import dataclasses
from typing import Any

import jax.numpy as jnp

from pinav.commands.fit.settings import FitSettings
from pinav.commands.reproduce.settings import ReproduceSettings
from pinav.dynamics import FixedStep
from pinav.fitting import (
    AbstractObjective,
    AbstractPhase,
    TrajectoryLoss,
    curriculum,
    paper_recipe,
)
from pinav.trajectories import Trajectories


@dataclasses.dataclass(frozen=True)
class Matching:
    """Everything of `fit_many` that a recipe's name decides.

    Attributes:
        recipe: the phases.
        objective: what they minimise.
        dtype: floating-point type of the fit.
    """

    recipe: tuple[AbstractPhase, ...]
    objective: AbstractObjective
    dtype: type

    @property
    def precision(self) -> str:
        """Name of the floating-point type, for files."""
        return jnp.dtype(self.dtype).name

    def options(self) -> dict[str, Any]:
        """As keyword arguments of `fit_many`, the recipe apart."""
        return {"objective": self.objective, "dtype": self.dtype}


def matching(settings: FitSettings | ReproduceSettings, data: Trajectories) -> Matching:
    """The paper's recipe as the paper has it, or the Gauss-Newton curriculum."""
    if settings.recipe == "paper":
        recipe = paper_recipe(settings.adam_steps, settings.lbfgs_steps)
        return Matching(recipe, TrajectoryLoss(FixedStep()), jnp.float32)
    recipe = curriculum(data, max_steps=settings.max_steps)
    return Matching(recipe, TrajectoryLoss(FixedStep(substeps=2)), jnp.float64)
