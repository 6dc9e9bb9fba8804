"""Settings of `pinav study`; imports no numerical library, so that help is quick."""

from typing import Annotated, Literal

import tyro

from pinav.commands.settings import (
    AsJson,
    ConfigFile,
    ModelName,
    OutFolder,
    Overwrite,
    RecipeName,
    Resume,
    Settings,
)
from pinav.errors import InputError

StudyName = Literal["data-efficiency", "noise", "paper-weakness"]

StudyModel = ModelName | Literal["sfi"]

MODELS: tuple[StudyModel, ...] = (
    "kernel-potential",
    "kernel-force",
    "neural-potential",
    "neural-force",
    "ude",
    "physics-only",
    "nn-only",
)


class StudySettings(Settings, frozen=True):
    """Settings of `pinav study`."""

    models: Annotated[
        tuple[StudyModel, ...],
        tyro.conf.arg(
            help="Models to compare; ude is the paper's network with time, sfi "
            "StochasticForceInference (pip install 'pinav[bench]')."
        ),
    ] = MODELS
    seeds: Annotated[
        tuple[int, ...],
        tyro.conf.arg(help="Seeds of starts, noise and networks, one fit for each."),
    ] = (0,)
    counts: Annotated[
        tuple[int, ...],
        tyro.conf.arg(help="data-efficiency: numbers of trajectories, nested."),
    ] = (1, 2, 4, 8, 16, 32)
    sigmas: Annotated[
        tuple[float, ...],
        tyro.conf.arg(help="noise: standard deviations of the observations."),
    ] = (0.0, 0.005, 0.01, 0.02, 0.05, 0.1)
    count: Annotated[
        int, tyro.conf.arg(help="noise, paper-weakness: number of trajectories.")
    ] = 8
    sigma: Annotated[
        float,
        tyro.conf.arg(
            help="data-efficiency, paper-weakness: standard deviation of the "
            "observations."
        ),
    ] = 0.02
    held_out: Annotated[
        int, tyro.conf.arg(help="Number of clean starts that no model is fitted to.")
    ] = 64
    max_steps: Annotated[
        int,
        tyro.conf.arg(help="Steps of each fit, or of each of its windows, at most."),
    ] = 20
    recipe: Annotated[
        RecipeName,
        tyro.conf.arg(
            help="paper-weakness: how the paper's network is trained; default: "
            "Gauss-Newton curriculum, paper: Adam, then L-BFGS."
        ),
    ] = "default"

    def check(self) -> None:
        """Raise `InputError` where a setting makes no sense."""
        for name in ("models", "seeds", "counts", "sigmas"):
            values = getattr(self, name)
            if not values:
                raise InputError(f"--{name}: expected at least one")
            for value in values:
                if values.count(value) > 1:
                    raise InputError(f"--{name}: {value} is given twice; drop one")
        for name in ("count", "held_out", "max_steps"):
            _check_at_least(name, getattr(self, name), 1)
        for value in self.counts:
            _check_at_least("counts", value, 1)
        for value in (*self.sigmas, self.sigma):
            _check_at_least("sigmas", value, 0)


def _check_at_least(name: str, value: float | int, least: int) -> None:
    if not least <= value < float("inf"):
        option = name.replace("_", "-")
        raise InputError(f"--{option}: expected {least} or more, got {value}")


class StudyOptions(Settings, frozen=True):
    """Compare models over the amount of data or of noise, one figure for each study.

    data-efficiency: force and rollout error over the number of trajectories; noise:
    the same over the noise of the observations; paper-weakness: the paper's network on
    its single trajectory beside a kernel potential on several. All data are synthetic.
    A killed study goes on with --resume.
    """

    name: Annotated[StudyName, tyro.conf.Positional, tyro.conf.arg(help="Which study.")]
    out: OutFolder
    scenario: Annotated[
        str,
        tyro.conf.Positional,
        tyro.conf.arg(
            help="Name of the scenario (docs/scenarios.md); paper-weakness has its own."
        ),
    ] = "barrier-crossings"
    settings: StudySettings = StudySettings()
    config: ConfigFile = None
    resume: Resume = False
    overwrite: Overwrite = False
    json: AsJson = False
