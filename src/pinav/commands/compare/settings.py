"""Settings of `pinav compare`."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from pinav.commands.settings import (
    AsJson,
    ConfigFile,
    OutFolder,
    Overwrite,
    Resume,
    Settings,
    SystemName,
    check_counts,
)
from pinav.errors import InputError

Candidate = Literal[
    "kernel-potential",
    "kernel-force",
    "kernel-mixture",
    "kernel-potential-time",
    "first-order",
    "isotropic-drag",
    "anisotropic-drag",
    "neural-potential",
    "neural-force",
    "physics-only",
]


class CompareSettings(Settings, frozen=True):
    """Settings of `pinav compare`."""

    models: Annotated[
        tuple[Candidate, ...],
        tyro.conf.arg(
            help="Models to compare. kernel-, neural-: as in pinav fit; physics-only: "
            "no environment; first-order: a kernel potential without inertia "
            "(positions alone); isotropic-drag, anisotropic-drag: a kernel potential, "
            "with the drag learned too."
        ),
    ] = ("kernel-potential", "kernel-force", "kernel-mixture")
    noise: Annotated[
        float | None,
        tyro.conf.arg(
            help="Standard deviation of the observations; estimated unless given."
        ),
    ] = None
    system: SystemName = None
    max_steps: Annotated[int, tyro.conf.arg(help="Steps of each fit at most.")] = 20

    def check(self) -> None:
        """Raise `InputError` where a setting makes no sense."""
        check_counts(self, "max_steps")
        if len(set(self.models)) < 2:
            raise InputError(
                "--models: expected two or more different ones, such as --models "
                "kernel-potential kernel-force"
            )


class CompareOptions(Settings, frozen=True):
    """Fit several models to the same trajectories and weigh their evidence.

    Prints the log evidence of each, what its hyperparameters cost, and a verdict with
    its number on each question that two of the models answer.
    """

    data: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(help="Trajectories, .npz or .csv.")
    ]
    out: OutFolder
    settings: CompareSettings = CompareSettings()
    config: ConfigFile = None
    resume: Resume = False
    overwrite: Overwrite = False
    json: AsJson = False
