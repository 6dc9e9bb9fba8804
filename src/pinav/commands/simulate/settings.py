"""Settings of `pinav simulate`."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.settings import (
    AsJson,
    Range,
    Settings,
)
from pinav.errors import InputError


class SimulateSettings(Settings, frozen=True):
    """Settings of `pinav simulate`.

    Attributes:
        seed: Seed of random starts and observation noise.
        noise: Standard deviation of observation noise, in every state.
        count: Number of trajectories; that of the system unless given. More of a seed
            begin with the same ones.
        frame_loss: Probability that a sample is missing.
        positions_only: Leave the velocities unobserved.
    """

    seed: int = 0
    noise: Annotated[float | None, Range(0)] = None
    count: Annotated[int | None, Range(1)] = None
    frame_loss: float = 0.0
    positions_only: bool = False

    def check_together(self) -> None:
        if not 0 <= self.frame_loss < 1:
            raise InputError(
                f"--frame-loss: expected from 0 to below 1, got {self.frame_loss}"
            )


class SimulateOptions(Settings, frozen=True):
    """Write the trajectories of a system to a .npz or .csv file.

    Attributes:
        system: A built-in system such as barrier-crossings (docs/scenarios.md lists
            them), a file my.toml (docs/systems.md), or my.py:name.
        out: File to write, .npz or .csv.
        overwrite: Replace the file if it is there.
    """

    system: tyro.conf.Positional[str]
    out: Path
    settings: SimulateSettings = SimulateSettings()
    overwrite: bool = False
    json: AsJson = False
