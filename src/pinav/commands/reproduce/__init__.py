"""Settings of `pinav reproduce`."""

from pathlib import Path
from typing import Annotated, Literal

from pinav.commands.settings import MaxSteps, ResumableOptions, Settings, Several
from pinav.learning.recipes import Curriculum, Paper


class ReproduceSettings(Settings, frozen=True):
    """Settings of `pinav reproduce`.

    Attributes:
        recipe: default: Gauss-Newton, from one-step matching to the full rollout;
            paper: Adam, then L-BFGS, as in its Table 1.
        seeds: Seeds of the networks; several train in one batch.
        max_steps: Default recipe: steps of each phase at most.
        adam_steps: Paper's recipe: steps of Adam (7500 in the paper).
        lbfgs_steps: Paper's recipe: steps of L-BFGS (500 in the paper).
    """

    recipe: Literal["default", "paper"] = "default"
    seeds: Annotated[tuple[int, ...], Several()] = (42,)
    max_steps: MaxSteps = Curriculum().max_steps
    adam_steps: MaxSteps = Paper().adam_steps
    lbfgs_steps: MaxSteps = Paper().lbfgs_steps


class ReproduceOptions(ResumableOptions, frozen=True, kw_only=True):
    """Run the paper's experiment, from nothing to its table and figures.

    Simulates the Gaussian-barrier benchmark, trains the UDE and the network-only
    baseline, scores them in float64, prints Table 2 beside the paper's values and
    writes report.html. A killed run goes on with --resume.
    """

    settings: ReproduceSettings = ReproduceSettings()
    out: Path = Path("runs/reproduce")
