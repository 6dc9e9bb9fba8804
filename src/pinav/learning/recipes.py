"""The recipes of a fit: each a struct with the options that it alone has.

This module imports no numerical library, so that `--help` is quick.
"""

from typing import Annotated, Literal

from pinav.settings import MAX_STEPS, Range, Settings

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


class Langevin(Settings, frozen=True, tag_field="recipe", tag="langevin"):
    """Thermal motion without inertia: as bayes, with the diffusion coefficient.

    Each option may stand in [unknown] of the system file, too.

    Attributes:
        observation: exact: positions without error; learn: the camera averages over an
            exposure and errs, and both are learned, so that neither biases the
            diffusion or the force; known: both are what the system states. Exact
            unless given.
        diffusion: constant: one number; field: it varies in space; tensor: it varies,
            and has a field of its own along each of --coordinates, and one along all
            others. Where the system has a thermal energy, the mobility follows from
            the diffusion (Einstein). Constant unless given.
        coordinates: Names of the coordinates on which force and diffusion depend, the
            force acting along them; all unless given.
        period: Coordinates that repeat, with their period, such as x=6.2832.
        warp: Coordinates whose kernels are finer at the end of the data where motion
            is slow, as near a wall.
        reference: The coordinate whose zero drifts slowly, such as the height above a
            wall that the focus leaves.
    """

    observation: Literal["exact", "learn", "known"] | None = None
    diffusion: Literal["constant", "field", "tensor"] | None = None
    coordinates: tuple[str, ...] = ()
    period: tuple[str, ...] = ()
    warp: tuple[str, ...] = ()
    reference: str | None = None

    @property
    def has_profile(self) -> bool:
        """The force has coordinates of its own."""
        return bool(self.coordinates or self.period or self.warp)


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
