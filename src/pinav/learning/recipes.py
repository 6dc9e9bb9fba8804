"""The recipes of a fit: each a struct with the options that it alone has.

This module imports no numerical library, so that `--help` is quick.
"""

from typing import Annotated, Literal

from pinav.settings import MAX_STEPS, Range, Settings, ThermalSettings

ModelName = Literal[
    "kernel-potential",
    "kernel-force",
    "kernel-mixture",
    "kernel-potential-time",
    "neural-potential",
    "neural-force",
    "ude",
    "physics-only",
    "nn-only",
]
"""Models that stand for the unknown."""

MaxSteps = Annotated[int, Range(1, most=10**6)]


class Searching(Settings, frozen=True):
    """The options of a fit that chooses by the evidence.

    Attributes:
        noise: Standard deviation of the observations; estimated unless given.
        structure: Search for a structure of the force (a centre, a wall, a linear
            flow), which the evidence may prefer to free kernels; a network learns from
            the fit of kernels that this gives; free: kernels alone.
        max_steps: Steps at most.
        budget: Seconds after which the search tries nothing more, and the best fit so
            far is the result; no limit unless given.
    """

    noise: Annotated[float | None, Range(above=0)] = None
    structure: Literal["search", "free"] = "search"
    max_steps: MaxSteps = MAX_STEPS
    budget: Annotated[float | None, Range(above=0)] = None


class Suited(Searching, frozen=True, tag_field="recipe", tag="default"):
    """What suits the data.

    It is langevin for Brownian paths, curriculum for the models ude and nn-only, else
    bayes.
    """


class Bayes(Searching, frozen=True, tag_field="recipe", tag="bayes"):
    """Noisy or incomplete data: the evidence chooses, and there is a posterior."""


class Langevin(ThermalSettings, frozen=True, tag_field="recipe", tag="langevin"):
    """Thermal motion without inertia: as bayes, with the diffusion coefficient.

    Each option may stand in [unknown] of the system file, too.
    """


class Curriculum(Settings, frozen=True, tag_field="recipe", tag="curriculum"):
    """Noise-free data: Gauss-Newton from one-step matching to the full rollout.

    Attributes:
        max_steps: Steps of each window at most.
    """

    max_steps: MaxSteps = MAX_STEPS


class Paper(Settings, frozen=True, tag_field="recipe", tag="paper"):
    """The paper's recipe: Adam, then L-BFGS.

    Attributes:
        adam_steps: Steps of Adam.
        lbfgs_steps: Steps of L-BFGS.
    """

    adam_steps: MaxSteps = 7500
    lbfgs_steps: MaxSteps = 500


Recipe = Suited | Bayes | Langevin | Curriculum | Paper
"""Recipes that `learn` and the option `--recipe` take."""

SUITED = Suited()
"""The recipe that suits the data, with no option set."""

Inferring = Bayes | Langevin
"""Recipes that choose by the evidence and give a posterior."""

Matching = Curriculum | Paper
"""Recipes that match trajectories, without a posterior."""


def name_of(recipe: Recipe) -> str:
    """The word for a recipe."""
    return str(type(recipe).__struct_config__.tag)
