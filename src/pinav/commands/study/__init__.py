"""Settings of `pinav study`; imports no numerical library, so that help is quick."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from pinav.commands.settings import (
    ALONE,
    MAX_STEPS,
    MaxSteps,
    ModelName,
    Range,
    ResumableOptions,
    Settings,
    Several,
    WorkerSettings,
)

StudyName = Literal["data-efficiency", "noise"]

MODELS: tuple[ModelName, ...] = (
    "kernel-potential",
    "kernel-force",
    "neural-potential",
    "neural-force",
    "ude",
    "physics-only",
    "nn-only",
)

SIGMAS = (0.0, 0.005, 0.01, 0.02, 0.05, 0.1)


class StudySettings(Settings, frozen=True):
    """Settings of `pinav study`.

    Attributes:
        models: Models to compare; ude is the paper's network with time.
        seeds: Seeds of starts, noise and networks, one fit for each.
        counts: data-efficiency: numbers of trajectories, nested.
        sigmas: noise: standard deviations of the observations.
        count: noise: number of trajectories.
        sigma: data-efficiency: standard deviation of the observations.
        held_out: Number of clean starts that no model is fitted to.
        max_steps: Steps of each fit, or of each of its windows, at most.
    """

    models: Annotated[tuple[ModelName, ...], Several()] = MODELS
    seeds: Annotated[tuple[int, ...], Several()] = (0,)
    counts: Annotated[tuple[int, ...], Several(), Range(1)] = (1, 2, 4, 8, 16, 32)
    sigmas: Annotated[tuple[float, ...], Several(), Range(0)] = SIGMAS
    count: Annotated[int, Range(1)] = 8
    sigma: Annotated[float, Range(0)] = 0.02
    held_out: Annotated[int, Range(1)] = 64
    max_steps: MaxSteps = MAX_STEPS


class StudyOptions(ResumableOptions, frozen=True, kw_only=True):
    """Compare models over the amount of data or of noise, one figure for each study.

    data-efficiency: force and rollout error over the number of trajectories; noise:
    the same over the noise of the observations. All data are synthetic. A killed study
    goes on with --resume; pinav study status DIR tells how far it is.

    Attributes:
        name: Which study; status: how far that of a folder is.
        scenario: Name of the scenario (docs/scenarios.md). status: the folder of the
            study.
    """

    name: tyro.conf.Positional[StudyName | Literal["status"]]
    scenario: tyro.conf.Positional[str] = "barrier-crossings"
    settings: StudySettings = StudySettings()
    workers: WorkerSettings = ALONE
    out: Path = Path("runs/study")
