"""Settings of `pinav simulate`."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.settings import (
    AsJson,
    Settings,
    check_counts,
)
from pinav.errors import InputError


class SimulateSettings(Settings, frozen=True):
    """Settings of `pinav simulate`."""

    seed: Annotated[
        int, tyro.conf.arg(help="Seed of random starts and observation noise.")
    ] = 0
    noise: Annotated[
        float | None,
        tyro.conf.arg(help="Standard deviation of observation noise, in every state."),
    ] = None
    count: Annotated[
        int | None,
        tyro.conf.arg(
            help="Number of trajectories; that of the system unless given. More of a "
            "seed begin with the same ones."
        ),
    ] = None
    frame_loss: Annotated[
        float, tyro.conf.arg(help="Probability that a sample is missing.")
    ] = 0.0
    positions_only: Annotated[
        bool, tyro.conf.arg(help="Leave the velocities unobserved.")
    ] = False

    def check(self) -> None:
        """Raise `InputError` where a setting makes no sense."""
        if self.noise is not None and self.noise < 0:
            raise InputError(f"--noise: expected 0 or more, got {self.noise}")
        if not 0 <= self.frame_loss < 1:
            raise InputError(
                f"--frame-loss: expected from 0 to below 1, got {self.frame_loss}"
            )
        if self.count is not None:
            check_counts(self, "count")


class SimulateOptions(Settings, frozen=True):
    """Write the trajectories of a system to a .npz or .csv file."""

    system: Annotated[
        str,
        tyro.conf.Positional,
        tyro.conf.arg(
            help="A built-in system such as barrier-crossings (docs/scenarios.md lists "
            "them), a file my.toml (docs/systems.md), or my.py:name."
        ),
    ]
    out: Annotated[Path, tyro.conf.arg(help="File to write, .npz or .csv.")]
    settings: SimulateSettings = SimulateSettings()
    overwrite: Annotated[
        bool, tyro.conf.arg(help="Replace the file if it is there.")
    ] = False
    json: AsJson = False
