"""Settings of `pinav compare`."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from pinav.commands.settings import (
    MAX_STEPS,
    MaxSteps,
    ResumableOptions,
    Settings,
    Several,
    SystemName,
)

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
    """Settings of `pinav compare`.

    Attributes:
        models: Models to compare. kernel-, neural-: as in pinav fit; physics-only: no
            environment; first-order: a kernel potential without inertia (positions
            alone); isotropic-drag, anisotropic-drag: a kernel potential, with the drag
            learned too.
        noise: Standard deviation of the observations; estimated unless given.
        max_steps: Steps of each fit at most.
    """

    models: Annotated[tuple[Candidate, ...], Several(2)] = (
        "kernel-potential",
        "kernel-force",
        "kernel-mixture",
    )
    noise: float | None = None
    system: SystemName = None
    max_steps: MaxSteps = MAX_STEPS


class CompareOptions(ResumableOptions, frozen=True):
    """Fit several models to the same trajectories and weigh their evidence.

    Prints the log evidence of each, what its hyperparameters cost, and a verdict with
    its number on each question that two of the models answer.

    Attributes:
        data: Trajectories, .npz or .csv.
    """

    data: tyro.conf.Positional[Path]
    settings: CompareSettings = CompareSettings()
