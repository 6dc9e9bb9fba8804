"""Options of `pinav simulate`."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.settings import AsJson, Range, Settings


class SimulateOptions(Settings, frozen=True, kw_only=True):
    """Write the trajectories of a system to a .npz or .csv file.

    Attributes:
        system: A built-in system such as barrier-crossings (docs/scenarios.md lists
            them), a file my.toml (docs/systems.md), or my.py:name.
        out: File to write, .npz or .csv.
        seed: Seed of random starts and observation noise.
        noise: Standard deviation of observation noise, in every state.
        count: Number of trajectories; that of the system unless given. More of a seed
            begin with the same ones.
        frame_loss: Probability that a sample is missing.
        positions_only: Leave the velocities unobserved.
        overwrite: Replace the file if it is there.
    """

    system: tyro.conf.Positional[str]
    out: Path
    seed: int = 0
    noise: Annotated[float | None, Range(0)] = None
    count: Annotated[int | None, Range(1)] = None
    frame_loss: Annotated[float, Range(0, below=1)] = 0.0
    positions_only: bool = False
    overwrite: bool = False
    json: AsJson = False
