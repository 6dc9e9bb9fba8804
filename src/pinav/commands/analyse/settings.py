"""Settings of `pinav analyse`."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.settings import (
    AsJson,
    Settings,
    check_counts,
)
from pinav.errors import InputError


class AnalyseSettings(Settings, frozen=True):
    """Settings of `pinav analyse`."""

    points: Annotated[
        int, tyro.conf.arg(help="Grid points along each side of the maps.")
    ] = 41
    draws: Annotated[
        int, tyro.conf.arg(help="Posterior samples behind the spread of fractions.")
    ] = 32
    samples: Annotated[
        int, tyro.conf.arg(help="Samples of the Sobol' indices, a power of two.")
    ] = 256
    reference: Annotated[
        int,
        tyro.conf.arg(
            help="Trajectory whose rollout is varied; counted from 0.",
        ),
    ] = 0
    relative: Annotated[
        float,
        tyro.conf.arg(
            help="Half range of damping, gain and strength of the environment, "
            "relative to their values."
        ),
    ] = 0.1
    shift: Annotated[
        float,
        tyro.conf.arg(
            help="Half range of each coordinate of the start, in units of length."
        ),
    ] = 0.1
    seed: Annotated[int, tyro.conf.arg(help="Seed of all random numbers.")] = 0

    def check(self) -> None:
        """Raise `InputError` where a setting makes no sense."""
        check_counts(self, "samples")
        for name, least in (("points", 5), ("draws", 2), ("reference", 0)):
            if getattr(self, name) < least:
                raise InputError(
                    f"--{name}: expected {least} or more, got {getattr(self, name)}"
                )
        if self.samples & (self.samples - 1) or self.samples < 2:
            raise InputError(
                f"--samples: expected a power of two, such as 256, got {self.samples}"
            )
        if not 0 < self.relative < 1:
            raise InputError(
                f"--relative: expected between 0 and 1, got {self.relative}"
            )
        if not 0 < self.shift < float("inf"):
            raise InputError(f"--shift: expected a length > 0, got {self.shift}")


class AnalyseOptions(Settings, frozen=True):
    """Map what a fit learned, and what it depends on; adds to its report.

    Writes analysis.json, analysis-*.csv, figures and sections of report.html: gradient
    and rotational part of the force, potential, signal to noise, influence of each
    trajectory and constant, dependence of rollouts on start and parameters. What needs
    a posterior is left out where the run has none.
    """

    run: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(help="Folder of a run of pinav fit.")
    ]
    settings: AnalyseSettings = AnalyseSettings()
    json: AsJson = False
