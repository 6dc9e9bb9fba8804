"""Settings of `pinav reproduce`."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.settings import (
    AsJson,
    ConfigFile,
    OutFolder,
    Overwrite,
    RecipeName,
    Resume,
    Settings,
    check_counts,
)
from pinav.errors import InputError


class ReproduceSettings(Settings, frozen=True):
    """Settings of `pinav reproduce`."""

    recipe: Annotated[
        RecipeName,
        tyro.conf.arg(
            help="default: Gauss-Newton, from one-step matching to the full rollout; "
            "paper: Adam, then L-BFGS, as in its Table 1."
        ),
    ] = "default"
    seeds: Annotated[
        tuple[int, ...],
        tyro.conf.arg(help="Seeds of the networks; several train in one batch."),
    ] = (42,)
    max_steps: Annotated[
        int, tyro.conf.arg(help="Default recipe: steps of each phase at most.")
    ] = 20
    adam_steps: Annotated[
        int, tyro.conf.arg(help="Paper's recipe: steps of Adam (7500 in the paper).")
    ] = 7500
    lbfgs_steps: Annotated[
        int, tyro.conf.arg(help="Paper's recipe: steps of L-BFGS (500 in the paper).")
    ] = 500

    def check(self) -> None:
        """Raise `InputError` where a setting makes no sense."""
        if not self.seeds:
            raise InputError("--seeds: expected at least one seed, such as --seeds 42")
        repeated = [seed for seed in self.seeds if self.seeds.count(seed) > 1]
        if repeated:
            raise InputError(f"--seeds: {repeated[0]} is given twice; drop one")
        check_counts(self, "max_steps", "adam_steps", "lbfgs_steps")


class ReproduceOptions(Settings, frozen=True):
    """Run the paper's experiment, from nothing to its table and figures.

    Simulates the Gaussian-barrier benchmark, trains the UDE and the network-only
    baseline, scores them in float64, prints Table 2 beside the paper's values and
    writes report.html. A killed run goes on with --resume.
    """

    settings: ReproduceSettings = ReproduceSettings()
    out: OutFolder = Path("runs/reproduce")
    config: ConfigFile = None
    resume: Resume = False
    overwrite: Overwrite = False
    json: AsJson = False
